from setuptools import find_packages, setup

package_name = "rig_bag"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test", "tests"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "numpy", "PyYAML", "zstandard"],
    extras_require={"test": ["pytest", "hypothesis", "mcap", "rosbags"]},
    zip_safe=True,
    maintainer="Shared Control Rig maintainers",
    maintainer_email="maintainers@shared-control-rig.example",
    description="Records, describes and plays MCAP bags in rosbag2's layout.",
    license="Apache-2.0",
    entry_points={"console_scripts": ["recorder = rig_bag.recorder:main"]},
)
