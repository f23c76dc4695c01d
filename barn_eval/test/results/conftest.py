"""Results that tests change."""

import shutil

import pytest


@pytest.fixture
def folder(two_trials, tmp_path):
    """A run of two trials that keeps no bags."""
    return shutil.copytree(two_trials, tmp_path / "out")
