from setuptools import find_packages, setup

NAME = "predictive_planners"

setup(
    name=NAME,
    version="0.1.0",
    description="Follow-the-gap and MPPI that predict what moves",
    license="Apache-2.0",
    maintainer="Your name",
    maintainer_email="you@example.org",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    # The suite is not listed: it is barn-suite or barn_planners, as it was installed.
    install_requires=["numpy", "numba"],
    zip_safe=False,
    entry_points={
        "barn_planners.planners": [
            f"gap_predictive = {NAME}.planners:GAP_ENTRY",
            f"mppi_predictive = {NAME}.planners:MPPI_ENTRY",
        ]
    },
)
