from glob import glob

from setuptools import find_packages, setup

NAME = "template_planner"

setup(
    name=NAME,
    version="0.1.0",
    description="A planner to copy",
    license="Apache-2.0",
    maintainer="Your name",
    maintainer_email="you@example.org",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.py")),
    ],
    install_requires=["numpy"],
    zip_safe=False,
    entry_points={
        "console_scripts": [f"{NAME} = {NAME}.node:main"],
        "barn_planners.planners": [f"template = {NAME}.registered:ENTRY"],
    },
)
