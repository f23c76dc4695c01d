"""Installs the stand-ins with the file that imports them whenever Python starts."""

from setuptools import find_namespace_packages, setup
from setuptools.command.build_py import build_py


class BuildWithPathFile(build_py):
    """Builds with the file beside the package."""

    def run(self):
        """Build the package and copy the file."""
        super().run()
        self.copy_file("barn_ros_stand_ins.pth", self.build_lib)


setup(
    name="barn-ros-stand-ins",
    version="0.1.0",
    description="Plain Python in place of ROS packages that have no wheel",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_namespace_packages(include=["barn_ros_stand_ins*"]),
    install_requires=["numpy", "scipy"],
    cmdclass={"build_py": BuildWithPathFile},
)
