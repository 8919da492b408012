from setuptools import find_packages, setup

NAME = "rig_runtime"

setup(
    name=NAME,
    version="0.1.0",
    description="What every node of the rig shares: parameters, topics, ticks, readiness, diagnostics and run.",
    license="Apache-2.0",
    maintainer="Shared Control Rig maintainers",
    maintainer_email="maintainers@shared-control-rig.example",
    packages=find_packages(),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
)
