from setuptools import find_packages, setup

NAME = "rig_display"

setup(
    name=NAME,
    version="0.1.0",
    description="A browser page that shows the task live and takes a person's hand as the force sensor.",
    license="Apache-2.0",
    maintainer="Shared Control Rig maintainers",
    maintainer_email="maintainers@shared-control-rig.example",
    packages=find_packages(),
    package_data={NAME: ["py.typed", "page/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    # The page is served from its files.
    zip_safe=False,
    entry_points={"console_scripts": ["display = rig_display.main:main"]},
)
