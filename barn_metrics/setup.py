from glob import glob
from xml.etree import ElementTree

from setuptools import find_packages, setup

ABOUT = ElementTree.parse("package.xml").getroot()
NAME, VERSION = ABOUT.findtext("name"), ABOUT.findtext("version")

setup(
    name=NAME,
    version=VERSION,
    description=ABOUT.findtext("description"),
    license=ABOUT.findtext("license"),
    maintainer=ABOUT.findtext("maintainer"),
    maintainer_email=ABOUT.find("maintainer").get("email"),
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed", "data/**/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
    ],
    python_requires=">=3.10",
    install_requires=[
        f"barn_worlds=={VERSION}",
        "numpy>=1.26",
        "numba>=0.59",
        "scipy>=1.10",
        "matplotlib>=3.6",
    ],
    extras_require={"test": ["pytest", "hypothesis"], "training": ["torch>=2"]},
    zip_safe=False,
)
