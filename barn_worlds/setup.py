from glob import glob

from setuptools import find_packages, setup

NAME = "barn_worlds"

setup(
    name=NAME,
    version="0.1.0",
    description="Worlds of the BARN navigation benchmark: generator, geometry, data sets, formats, map server",
    license="Apache-2.0",
    maintainer="The BARN suite developers",
    maintainer_email="barn@example.org",
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
        "numpy>=1.26",
        "numba>=0.59",
        "cattrs>=23.2",
        "PyYAML>=6",
        "defusedxml>=0.7",
        "matplotlib>=3.6",
        "pillow>=9.2",
    ],
    extras_require={"test": ["pytest", "hypothesis"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "map_server = barn_worlds.ros.map_server:main",
        ],
    },
)
