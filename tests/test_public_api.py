"""The public interface, as the modules declare it: documented, with shapes and units, and with examples that run."""

import ast
import doctest
import inspect
import pkgutil
import re
from importlib import import_module
from pathlib import Path

import pytest

import fuzzyarm
import fuzzyarm.synthesis

FOUND = ["fuzzyarm", *sorted(module.name for module in pkgutil.walk_packages(fuzzyarm.__path__, "fuzzyarm."))]
MODULES = [name for name in FOUND if "._" not in name]  # of the others nothing is public

# A shape: (2,), (..., 2), (lanes, 10), shape (n, m), n x m, 6x6, or in words that name one number per something.
SHAPE = re.compile(r"\([^()\s][^()]*,[^()]*\)|\bshapes?\b|\d ?[x×] ?\d|\bscalars?\b|\blike\b")
# A unit in brackets, 0.1 s, or a word for numbers without one.
UNIT = re.compile(
    r"\[[^\]]*\]|\d ?(rad|m|s|N|J|kg|mm|Hz|W|°|%)\b|[µ%]|"
    r"\b(relative|share|fraction|ratio|factor|probability|level|weights?|numbers?|shapes?|units?)\b",
    re.I,
)


def public(name):
    """The public functions and classes that a module defines itself."""
    module = import_module(name)
    for symbol in getattr(module, "__all__", ()):
        found = getattr(module, symbol)
        if getattr(found, "__module__", None) == name and (inspect.isclass(found) or inspect.isroutine(found)):
            yield symbol, found


def callables(name):
    """The public functions of a module, and the methods of its public classes, with all text about them."""
    about = import_module(name).__doc__ or ""
    for symbol, found in public(name):
        if not inspect.isclass(found):
            yield symbol, found, "\n".join([about, found.__doc__ or ""])
            continue
        for key, member in vars(found).items():
            function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
            if inspect.isfunction(function) and function.__module__ == name and not key.startswith("_"):
                bases = [base for base in found.__mro__ if base.__module__.startswith("fuzzyarm")]
                texts = [text.__doc__ or "" for base in bases for text in (base, vars(base).get(key))]
                yield f"{symbol}.{key}", function, "\n".join([about, *texts])


def undocumented(name):
    found = {symbol: getattr(import_module(name), symbol) for symbol in import_module(name).__all__}
    found |= {place: function for place, function, _ in callables(name)}
    found = {place: one for place, one in found.items() if inspect.isclass(one) or inspect.isroutine(one)}
    return [place for place, one in found.items() if not inspect.getdoc(one)]


def lacking(name, types, pattern):
    """Public callables that take or return one of these types, and whose text has no match of a pattern."""
    for place, function, text in callables(name):
        written = map(str, inspect.get_annotations(function).values())
        kinds = (re.sub(r"\b(dict|Mapping|Callable)\b.*", "", kind) for kind in written)
        if any(types.search(kind) for kind in kinds) and not pattern.search(text):
            yield place


@pytest.mark.parametrize("folder", sorted({name.rpartition(".")[0] or name for name in MODULES}))
def test_what_a_module_declares_public_is_documented_with_shapes_and_units(folder):
    names = [name for name in MODULES if (name.rpartition(".")[0] or name) == folder]
    assert names
    for name in names:
        module = import_module(name)
        assert module.__doc__, f"{name}: no docstring"
        body = ast.parse(inspect.getsource(module)).body
        if not hasattr(module, "__all__") and all(isinstance(node, ast.Expr) for node in body):
            continue  # the docstring of a package that holds nothing else
        assert hasattr(module, "__all__"), f"{name}: no __all__"
        assert len(set(module.__all__)) == len(module.__all__), name
        assert undocumented(name) == [], name
        assert list(lacking(name, re.compile(r"\b(ndarray|ArrayLike|Tensor)\b"), SHAPE)) == [], name
        assert list(lacking(name, re.compile(r"\b(float|ndarray|ArrayLike)\b"), UNIT)) == [], name


ROOT = Path(fuzzyarm.__file__).parents[1]
WITH_EXAMPLES = [path.relative_to(ROOT) for path in ROOT.glob("fuzzyarm/**/*.py") if ">>>" in path.read_text("utf-8")]


@pytest.mark.parametrize("path", sorted(WITH_EXAMPLES), ids=str)
def test_examples_run(path):
    name = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
    assert doctest.testmod(import_module(name), optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE).failed == 0


@pytest.mark.parametrize("package", [fuzzyarm, fuzzyarm.synthesis], ids=lambda package: package.__name__)
def test_names_that_are_imported_when_first_asked_for_are_those_of_their_homes(package):
    assert set(package.__all__) - {"__version__", "load_policy"} == set(package._HOMES)
    for name, home in package._HOMES.items():
        assert getattr(package, name) is getattr(import_module(f"{package.__name__}.{home}"), name)
    with pytest.raises(AttributeError, match=f"module '{package.__name__}' has no attribute 'nosuch'"):
        _ = package.nosuch
