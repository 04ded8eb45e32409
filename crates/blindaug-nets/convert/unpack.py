"""Unpacks a package of PyPI or npm: `python unpack.py ARCHIVE FOLDER`."""

import sys
import tarfile
import zipfile

archive, folder = sys.argv[1:]
if zipfile.is_zipfile(archive):
    zipfile.ZipFile(archive).extractall(folder)
else:
    # Nothing outside of the folder.
    tarfile.open(archive).extractall(folder, filter="data")
