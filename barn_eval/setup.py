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
        ("bin", ["bin/barn"]),
        (f"share/{NAME}/launch", glob("launch/*.py")),
        (f"share/{NAME}/config", glob("config/*")),
    ],
    python_requires=">=3.10",
    install_requires=[
        f"barn_worlds=={VERSION}",
        f"barn_sim=={VERSION}",
        f"barn_planners=={VERSION}",
        f"barn_metrics=={VERSION}",
        "numpy>=1.26",
        "click>=8.1",
        "cloudpickle>=3",
        "rich>=13",
        "mcap>=1.6",
        "rosbags>=0.10",
        "zstandard>=0.21",
        "lz4>=4",
        "PyYAML>=6",
        "matplotlib>=3.8",
        "jinja2>=3.1",
        "pillow>=10.4",
        "scipy>=1.15",
        "pyarrow>=14",
        "pandas>=2",
    ],
    extras_require={"test": ["pytest", "hypothesis"], "ray": ["ray>=2.9"], "tuning": ["optuna>=4"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "barn = barn_eval.commands.main:main",
            "evaluator = barn_eval.ros.evaluator:main",
        ],
    },
)
