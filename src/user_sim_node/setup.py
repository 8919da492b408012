from setuptools import find_packages, setup

NAME = "user_sim_node"

setup(
    name=NAME,
    version="0.1.0",
    description="Simulated user: answers each state of the task with a force at the sensor.",
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
    entry_points={"console_scripts": ["user_sim_node = user_sim_node.main:main"]},
)
