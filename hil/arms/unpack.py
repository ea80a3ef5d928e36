"""Unpacks one folder of a wheel or source archive: unpack.py ARCHIVE FOLDER TO."""

import sys
import tarfile
import zipfile
from pathlib import Path

archive, folder, to = sys.argv[1:]
if archive.endswith(".whl"):
    with zipfile.ZipFile(archive) as file:
        file.extractall(to, [name for name in file.namelist() if name.startswith(folder + "/")])
else:
    with tarfile.open(archive) as file:
        file.extractall(to, [member for member in file if member.name.startswith(folder + "/")], filter="data")
if not (Path(to) / folder).is_dir():
    sys.exit(f"{archive} holds no {folder}")
