"""Unpacks a package of PyPI or npm: `python unpack.py ARCHIVE FOLDER`."""

import sys
import tarfile
import zipfile

# The most bytes that are unpacked.
MOST = 1 << 33

archive, folder = sys.argv[1:]
if zipfile.is_zipfile(archive):
    with zipfile.ZipFile(archive) as z:
        if sum(member.file_size for member in z.infolist()) > MOST:
            sys.exit("the package would unpack to more than 8 GiB")
        z.extractall(folder)
else:
    with tarfile.open(archive) as t:
        if sum(member.size for member in t.getmembers()) > MOST:
            sys.exit("the package would unpack to more than 8 GiB")
        # Nothing outside of the folder.
        t.extractall(folder, filter="data")
