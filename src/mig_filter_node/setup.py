from setuptools import find_packages, setup

NAME = "mig_filter_node"

setup(
    name=NAME,
    version="0.1.0",
    description="Judges each user action by the mode insertion gradient and admits, rejects or replaces it.",
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
    entry_points={"console_scripts": ["mig_filter_node = mig_filter_node.main:main"]},
)
