from glob import glob

from setuptools import find_packages, setup

NAME = "barn_sim"

setup(
    name=NAME,
    version="0.1.0",
    description="A PyBullet Clearpath Jackal with lidar, odometry and contact detection, as a library and as a ROS 2 node",
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
        "barn_worlds",
        "numpy>=1.26",
        "numba>=0.59",
        "pybullet>=3.2.5",
        "defusedxml",
        "PyYAML",
    ],
    extras_require={"test": ["pytest", "hypothesis", "scipy"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "simulator = barn_sim.ros.simulator:main",
        ],
    },
)
