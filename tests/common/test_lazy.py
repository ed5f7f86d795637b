"""Names that are imported when they are first asked for are those that the package declares, from where it says."""

import importlib

import pytest

import fuzzyarm
import fuzzyarm.synthesis


@pytest.mark.parametrize("package", [fuzzyarm, fuzzyarm.synthesis], ids=lambda package: package.__name__)
def test_declared_names_are_those_of_their_homes(package):
    assert set(package.__all__) - {"__version__", "load_policy"} == set(package._HOMES)
    for name, home in package._HOMES.items():
        assert getattr(package, name) is getattr(importlib.import_module(f"{package.__name__}.{home}"), name)
    with pytest.raises(AttributeError, match=f"module '{package.__name__}' has no attribute 'nosuch'"):
        _ = package.nosuch
