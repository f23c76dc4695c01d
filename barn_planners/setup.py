from glob import glob

from setuptools import find_packages, setup

NAME = "barn_planners"

setup(
    name=NAME,
    version="0.1.0",
    description="Local planners behind one interface: DWA, elastic bands, MPPI and baselines, as a library and as ROS 2 nodes",
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
    ],
    extras_require={"test": ["pytest", "hypothesis"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "planner = barn_planners.ros.planner:main",
            "dwa_planner = barn_planners.ros.planner:main_dwa",
            "eband_planner = barn_planners.ros.planner:main_eband",
            "mppi_planner = barn_planners.ros.planner:main_mppi",
            "policy_planner = barn_planners.ros.planner:main_policy",
        ],
    },
)
