from glob import glob

from setuptools import find_packages, setup

NAME = "barn_metrics"

setup(
    name=NAME,
    version="0.1.0",
    description="Difficulty metrics of navigation worlds and the learned difficulty model",
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
        "scipy>=1.10",
        "matplotlib>=3.6",
    ],
    extras_require={"test": ["pytest", "hypothesis"], "training": ["torch>=2", "scikit-learn>=1.3"]},
    zip_safe=False,
)
