"""The pages, built once for all tests that look at them."""

import pytest
from support.documentation import build


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """The folder of the built pages, whose tutorials have just been executed."""
    pytest.importorskip("sphinx")
    folder = tmp_path_factory.mktemp("site")
    done = build(folder)
    assert done.returncode == 0, done.stderr[-5000:]
    return folder
