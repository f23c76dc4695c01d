"""Zip archives of arrays, for tests: their members, and the same files with other members."""

import io
import zipfile

import numpy as np


def members(path):
    """Return the content of each member by name."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def repack(path, changes):
    """Rewrite a zip file with some members changed or added, or removed where the value is None."""
    content = members(path) | changes
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            if data is not None:
                archive.writestr(name, data)


def pickled():
    """Return the bytes of a .npy file with a pickled object."""
    file = io.BytesIO()
    np.save(file, np.array([print], dtype=object))
    return file.getvalue()
