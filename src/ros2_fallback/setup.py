from setuptools import find_packages, setup

package_name = "ros2_fallback"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "PyYAML"],
    zip_safe=True,
    maintainer="Shared Control Rig maintainers",
    maintainer_email="maintainers@shared-control-rig.example",
    description="A ros2 command for machines that have rclpy but no ros2cli.",
    license="Apache-2.0",
    entry_points={"console_scripts": ["ros2 = ros2_fallback.__main__:entry"]},
)
