"""The list of mutants quotes the package as it is."""

from pathlib import Path

import pytest

import fuzzyarm

from .listed import MUTANTS


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_mutant_changes_one_place_of_the_package(mutant):
    text = (Path(fuzzyarm.__file__).parent / mutant.file).read_text(encoding="utf-8")
    assert text.count(mutant.old) == 1 and mutant.new != mutant.old
