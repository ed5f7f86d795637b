"""Archives of arrays are read as NumPy writes them; whatever else is in the file, one line, and no memory is taken."""

import io
import resource
import struct
import time
import zipfile

import numpy as np
import pytest

from fuzzyarm.common.array_files import read_arrays
from fuzzyarm.common.documents import DocumentError

RECORD = np.dtype([("mass", float, (2,)), ("seed", np.int64)])
ARRAYS = {
    "text": np.array("fuzzy-4 é"),
    "number": np.array(3.5),
    "flags": np.array([True, False]),
    "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "empty": np.zeros((0, 2)),
    "records": np.zeros(3, dtype=RECORD),
    "seed": np.array(7),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_come_back(tmp_path, save):
    save(tmp_path / "a.npz", **ARRAYS)
    found = read_arrays(tmp_path / "a.npz")
    assert set(found) == set(ARRAYS)
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype and np.array_equal(found[name], array)


def header(shape, descr="<f8"):
    text = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) + 1) + text + b"\n"


def archive(content, *names, compression=zipfile.ZIP_STORED):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as file:
        for name in names or ("a.npy",):
            file.writestr(name, content)
    return out.getvalue()


PLAIN = archive(header((2,)) + bytes(16))
TWICE = archive(header((2,)) + bytes(16), "a.npy", "b.npy").replace(b"b.npy", b"a.npy")


def patched(data, offset_local, offset_central, value):
    """Return an archive with a 16-bit field of its only member changed in both places that state it."""
    data = bytearray(data)
    central = data.index(b"PK\x01\x02")
    struct.pack_into("<H", data, offset_local, value)
    struct.pack_into("<H", data, central + offset_central, value)
    return bytes(data)


def lying_size():
    """A member that unpacks to 100 MB and states 144 bytes."""
    data = bytearray(archive(header((2,)) + bytes(10**8), compression=zipfile.ZIP_DEFLATED))
    struct.pack_into("<L", data, data.index(b"PK\x01\x02") + 24, len(header((2,))) + 16)
    return bytes(data)


BAD = {
    "encrypted": (lambda: patched(PLAIN, 6, 8, 1), "is encrypted"),
    "unknown compression": (lambda: patched(PLAIN, 8, 10, 99), "unsupported compression method 99"),
    "a shape of ten trillions": (lambda: archive(header((10**13,)) + bytes(16)), "has 16 bytes; needed: "),
    "a shape beyond all numbers": (lambda: archive(header((10**400, 0))), "damaged"),
    "a negative shape": (lambda: archive(header((-2, -1)) + bytes(16)), "has 16 bytes; needed: "),
    "no Unicode": (lambda: archive(header((), "<U1") + b"\x00\xd8\x00\x00"), "not valid Unicode"),
    "neither true nor false": (lambda: archive(header((), "|b1") + b"\x07"), "an invalid boolean"),
    "objects": (lambda: archive(header((), "|O") + b"\x07"), "has the type object; save arrays of numbers"),
    "no archive": (lambda: bytes(100), "does not end with the end record of a zip"),
    "nothing": (lambda: b"", "too short"),
    "a bomb": (lambda: archive(bytes(10**9), compression=zipfile.ZIP_DEFLATED), "arrays unpack to 1000000000"),
    "a bomb that lies": (lying_size, "damaged"),
    "a name twice": (lambda: TWICE, "two of its entries have the same name"),
    "a program": (lambda: archive(b"import os", "a.py"), "'a.py' is not an array"),
    "a deep header": (lambda: archive(b"\x93NUMPY\x01\x00" + struct.pack("<H", 9000) + b"(" * 9000), "damaged"),
    "another version": (lambda: archive(b"\x93NUMPY\x03\x00" + bytes(20)), "must be in version 1.0 of the .npy format"),
    "a far directory": (lambda: PLAIN[:-22] + struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, 2**31, 0, 0), "damaged"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_a_bad_archive_is_one_line_and_takes_neither_time_nor_memory(tmp_path, name):
    make, message = BAD[name]
    path = tmp_path / "a.npz"
    path.write_bytes(make())
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with pytest.raises(DocumentError, match=message) as caught:
        read_arrays(path)
    assert time.process_time() - begun < 1.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 60_000  # KiB
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300 + len(str(path))
