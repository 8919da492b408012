from setuptools import find_packages, setup

NAME = "admittance_sim_node"

setup(
    name=NAME,
    version="0.1.0",
    description="Simulated admittance-controlled robot: turns the admitted force into motion.",
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
    entry_points={"console_scripts": ["admittance_sim_node = admittance_sim_node.main:main"]},
)
