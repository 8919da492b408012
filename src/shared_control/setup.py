"""Build of the package, by colcon (ament_python) and by pip alone."""

from setuptools import find_packages, setup

NAME = "shared_control"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["numba", "numpy", "pyyaml", "scipy"],
    python_requires=">=3.10",
    zip_safe=False,
    maintainer="Shared Control Rig maintainers",
    maintainer_email="maintainers@shared-control-rig.example",
    description="The science of the shared-control rig: mode insertion gradient, filter, users, robot.",
    license="Apache-2.0",
)
