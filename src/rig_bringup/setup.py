from glob import glob

from setuptools import find_packages, setup

NAME = "rig_bringup"

setup(
    name=NAME,
    version="0.1.0",
    description="The command line behind ./rig: scenarios, starting and stopping the graph, the launch file.",
    license="Apache-2.0",
    maintainer="Shared Control Rig maintainers",
    maintainer_email="maintainers@shared-control-rig.example",
    packages=find_packages(),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/rig.launch.py"]),
        (f"share/{NAME}/config", sorted(glob("config/*.yaml"))),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    entry_points={"console_scripts": ["compose = rig_bringup.compose:main"]},
)
