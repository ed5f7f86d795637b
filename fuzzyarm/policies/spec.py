"""The names of policies: the policy that a name refers to, its label and files, and how it is loaded.

    fuzzy-4, computed-torque, ppo-robust, ...      a policy known by name, see `registry`
    fuzzy-4-tip, mine.json-tip                     the same law, which guides the tip along the reference
    mine.json                                      a controller file
    runs/mine                                      the folder of a learned policy
    my-arm/computed-torque, my-arm/fuzzy-4-tip     a policy of a folder that `fuzzyarm tune` wrote
    package.module:factory                         the user's own code, see `_user_code`
    shield:fuzzy-4-tip:GUEST:4,2                   any of these within ± (4, 2) N m of a law, see `laws.guest`

A name may come from a file, and files are not trusted: no name makes `resolve` or `load_policy` import or run code.
Code runs only if the user has named it in this process, with ``resolve(name, run_code=True)``.

Files of results record a relative path as given, but only the last part of an absolute path, or its last two parts in a
folder of `fuzzyarm tune`, since ``computed-torque`` alone would be another policy. With the digests of its files
(`PolicySpec.files`), this name identifies the policy without describing the machine.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import hashlib
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from fuzzyarm.policies.registry import FOREIGN, LAWS, POLICIES, TIP, Factory, Kind, foreign, known_names

if TYPE_CHECKING:
    from fuzzyarm.envs.physics.equations import AnyArm
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.policy import Policy
    from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController
    from fuzzyarm.policies._user_code import UserPolicy

__all__ = [
    "ANY_GUEST", "PolicySpec", "any_guest", "file_digest", "found_again", "load_policy", "recorded", "resolve",
    "resolve_all", "without_guest",
]  # fmt: skip

_SHIELD, ANY_GUEST = "shield:", "any"  # prefix of a shield's name; the guest that stands for every guest
_ROUTES = {ending: prefix for prefix, ending in FOREIGN.items()}  # prefix for the model of another library


class _Shield(NamedTuple):
    """The parts of a shield's name."""

    law: PolicySpec
    guest: PolicySpec  # with the name `ANY_GUEST` if it stands for every guest
    margin: str  # δ [N m], separated by commas

    def named(self, law: str, guest: str) -> str:
        """Return the name of this shield with other names for its law and guest."""
        return f"{_SHIELD}{law}:{guest}:{self.margin}"


@dataclasses.dataclass(frozen=True)
class PolicySpec:
    """The policy that a name refers to; made by `resolve`, which does not check whether the policy exists."""

    name: str  # as given
    kind: Kind  # what the policy is made from
    tip: bool = False  # whether its law is wrapped to guide the tip along the reference, see `registry.TIP`
    # the controller file, the folder of the learned policy, or the law in a tuned folder, which is not a file; None for
    # other kinds
    path: Path | None = None
    # whether the policy is known by name, from the package or `registry.add_policy`; its path is then the package's
    named: bool = False
    run_code: bool = False  # whether the user's own code may be imported and run
    tuned: bool = False  # whether the policy is in a folder of `fuzzyarm tune`; its default arm is that of the folder
    _factory: Factory | None = dataclasses.field(default=None, repr=False, compare=False)
    shield: _Shield | None = None  # the parts of a shield

    @property
    def code(self) -> str:
        """The user's code, ``package.module:factory``, for the policy or the policy inside a shield; empty if none."""
        if self.shield is not None:
            return self.shield.guest.code
        return self.name if self.kind is Kind.CODE and not foreign(self.name) else ""

    @property
    def label(self) -> str:
        """The label of the policy in tables and figures: its name, or its file's name without folder and ``.json``.

        A policy of `fuzzyarm train` is named after the folder of its training run, with ``-best`` for the run's
        best policy instead of the last.
        """
        from fuzzyarm.fuzzy_policy.laws.learned.bundle import BEST, LAST

        if self.shield is not None:
            return self.shield.named(self.shield.law.label, self.shield.guest.label)
        path = Path(self.name)
        if self.kind is Kind.LEARNED and path.name in (LAST, BEST) and path.parent.name:
            return path.parent.name if path.name == LAST else f"{path.parent.name}-{BEST}"
        prefix = foreign(self.name)
        return path.name.removeprefix(prefix).replace(FOREIGN.get(prefix, ".json"), "")

    def files(self) -> dict[str, str]:
        """Return the SHA-256, by file name, of the files the policy is made from.

        These are the controller file; the file of the laws of a tuned folder; ``policy.json`` of a learned policy,
        which contains the digest of the weights, and the files of its base; the module of the user's code, which is
        imported. A law of the package has no files, and neither has a policy that does not exist. ValueError if a
        learned policy is damaged, or a module fails or may not be run; OSError if a file cannot be read.
        """
        path = self.path or Path()
        self._check()
        if self.shield is not None:
            guest = {} if self.shield.guest.name == ANY_GUEST else self.shield.guest.files()
            return {**self.shield.law.files(), **guest}
        if self.kind is Kind.CODE:
            from fuzzyarm.policies._user_code import source_file

            source = source_file(self.name)
            return {} if source is None else {source.name: file_digest(source)}
        if self.kind is Kind.LEARNED and path.is_dir():
            from fuzzyarm.policies._learned import learned_files

            return learned_files(path)
        if self.kind is Kind.TUNED:
            from fuzzyarm.policies.tuned import NAME

            path = path.with_name(NAME)
        return {path.name: file_digest(path)} if self.kind in (Kind.CONTROLLER, Kind.TUNED) else {}

    def load(
        self,
        control_period: float = 1e-3,
        robot: AnyArm | str | os.PathLike[str] | None = None,
        allow_unproven: bool = False,
    ) -> Policy | UserPolicy:
        """Return the policy; arguments and errors as for `load_policy`, and ValueError if code fails or may not run."""
        from fuzzyarm.common.checks import truth
        from fuzzyarm.envs.physics.equations import chosen_arm

        path = self.path or Path()
        truth("allow_unproven", allow_unproven)
        self._check()
        if self.shield is not None:
            from fuzzyarm.policies.shield import shielded_of

            return shielded_of(self, control_period, robot, allow_unproven)
        arm = chosen_arm(path.parent if robot is None and self.tuned else robot, None)
        if self.kind is Kind.CODE:
            from fuzzyarm.policies._user_code import load_code

            return load_code(self.name, control_period, arm)
        if self._factory is not None:
            law = self._factory(arm, control_period)
        elif self.kind is Kind.CONTROLLER:
            from fuzzyarm.policies._controller_policy import controller_policy

            law = controller_policy(path, arm, control_period, allow_unproven)
        elif self.kind is Kind.TUNED:
            from fuzzyarm.policies.tuned import tuned_policy

            law = tuned_policy(path.parent, path.name, arm, control_period)
        elif path.is_dir():
            from fuzzyarm.policies._learned import learned_policy

            law = learned_policy(path, control_period, arm)
        else:
            nearest = difflib.get_close_matches(self.name, known_names(), n=1)
            hint = f"did you mean {nearest[0]}? Otherwise " if nearest else ""
            raise ValueError(
                f"unknown policy {self.name!r}; {hint}choose from: {', '.join(known_names())}. Also accepted: a "
                f"controller file (.json, .json{TIP}); the folder of a learned policy; on the command line, "
                f"package.module:factory; and {_SHIELD}LAW:POLICY:4,2, which keeps POLICY within ± (4, 2) N m of LAW"
            )
        if not self.tip:
            return law
        from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy

        return TipPolicy(law)

    def _check(self) -> None:
        """Raise ValueError for code without permission to run, another library's file, or a folder without a policy."""
        from fuzzyarm.fuzzy_policy.laws.learned.bundle import BEST, DESCRIPTION, LAST, WEIGHTS

        if self.kind is Kind.CODE and not self.run_code:
            what = "a model of another library" if foreign(self.name) else "code"
            raise ValueError(
                f"{self.name} names {what}, which load_policy does not run: use fuzzyarm evaluate --policy {self.name}"
                + ("" if foreign(self.name) else ", or import it yourself")
            )
        if self.kind is not Kind.LEARNED or self.path is None:
            return
        path, code = self.path, "write code that returns the policy, and use --policy module:factory"
        if path.suffix in _ROUTES:
            raise ValueError(f"{path} is a model of another library: write --policy {_ROUTES[path.suffix]}{path}")
        if path.suffix in (".pt", ".pth", ".safetensors"):
            raise ValueError(f"{path} contains only the weights of a network, not its layers: {code}")
        if path.is_dir() and not any((path / name).exists() for name in (DESCRIPTION, WEIGHTS)):
            inside = [str(path / name) for name in (LAST, BEST) if (path / name / DESCRIPTION).exists()]
            inside += [f"{_ROUTES[entry.suffix]}{entry}" for entry in sorted(path.iterdir()) if entry.suffix in _ROUTES]
            instead = f"write --policy {inside[0]}" if inside else code
            raise ValueError(
                f"{path} is not a policy folder: it contains neither {DESCRIPTION} nor {WEIGHTS}; {instead}"
            )


def resolve(name: str | os.PathLike[str], *, run_code: bool = False) -> PolicySpec:
    """Return the spec for a policy's name, without loading the policy; every string gives a spec.

    For names, see `fuzzyarm.policies.spec`. `run_code` states whether the spec may import and run the user's code; it
    must be True only for a name that the user has typed, never for a name read from a file.
    """
    if not isinstance(name, str | os.PathLike):
        raise TypeError(f"a policy's name must be a string or a path, not {type(name).__name__}")
    text = str(name)
    if text.startswith(_SHIELD):
        return _in_shield(text, run_code)
    subject = text.removesuffix(TIP)
    tip = subject != text
    known = POLICIES.get(subject)
    if known is not None and (known.has_tip or not tip):
        return PolicySpec(text, known.kind, tip, known.path, named=True, _factory=known.factory)
    if tuned := _in_tuned_folder(text, Path(subject), tip):
        return tuned
    if subject.endswith(".json"):
        return PolicySpec(text, Kind.CONTROLLER, tip, Path(subject))
    if _is_code(text):
        return PolicySpec(text, Kind.CODE, run_code=run_code)
    return PolicySpec(text, Kind.LEARNED, path=Path(text))


def _in_shield(name: str, run_code: bool) -> PolicySpec:
    law, _, rest = name.removeprefix(_SHIELD).partition(":")
    guest, _, margin = rest.rpartition(":")
    if not (law and guest and margin) or guest.startswith(_SHIELD):
        return PolicySpec(name, Kind.LEARNED, path=Path(name))  # an unknown name
    parts = _Shield(resolve(law), resolve(guest, run_code=run_code), margin)
    kind = Kind.CODE if parts.guest.kind is Kind.CODE else Kind.SHIELD
    return PolicySpec(name, kind, run_code=run_code, shield=parts)


def any_guest(name: str) -> str:
    """Return the name of a shield with its guest replaced by `ANY_GUEST`; any other name is unchanged."""
    shield = resolve(name).shield
    return name if shield is None else shield.named(shield.law.name, ANY_GUEST)


def without_guest(name: str) -> tuple[str, tuple[float, ...]]:
    """Return LAW and MARGIN (n,) [N m] of a name ``shield:LAW:GUEST:MARGIN``; any other name is returned with ()."""
    shield = resolve(name).shield
    if shield is None:
        return name, ()
    try:
        return shield.law.name, tuple(map(float, shield.margin.split(",")))
    except ValueError:
        raise ValueError(
            f"{name}: its margin {shield.margin!r} must be one torque for each joint [N m], such as 4,2"
        ) from None


def _in_tuned_folder(name: str, path: Path, tip: bool) -> PolicySpec | None:
    """Return the spec of `path` in a folder of `fuzzyarm tune`, else None; `name` is `path`, plus ``-tip`` if `tip`."""
    from fuzzyarm.policies.tuned import is_tuned

    if path.parent == Path() or not is_tuned(path.parent):
        return None
    if path.name in LAWS and (POLICIES[path.name].has_tip or not tip):
        return PolicySpec(name, Kind.TUNED, tip, path, tuned=True)
    file = path.with_name(f"{path.name.removesuffix('.json')}.json")
    return PolicySpec(name, Kind.CONTROLLER, tip, file, tuned=True) if os.path.isfile(file) else None


def resolve_all(names: Sequence[str], *, run_code: bool = False) -> dict[str, PolicySpec]:
    """Return the specs of several names by label; ValueError if two labels are equal or a name is not printable."""
    for name in names:
        if not name.isprintable():
            raise ValueError(f"policy {name!a}: its name contains characters that cannot be printed; rename the file")
    specs = {spec.label: spec for spec in (resolve(name, run_code=run_code) for name in names)}
    if len({label.replace(":", "-") for label in specs}) < len(names):  # file names replace ":" by "-", too
        raise ValueError(f"policies {', '.join(names)}: two of them have the same name; leave out or rename one")
    return specs


def load_policy(
    name: str | os.PathLike[str] | Controller | ScheduledController,
    *,
    control_period: float | None = None,
    robot: AnyArm | str | os.PathLike[str] | None = None,
    allow_unproven: bool = False,
) -> Policy:
    """Return a policy by name, or from a controller, its file, or a learned policy's folder.

    Code that a name refers to is never run.

    Args:
        name: see `fuzzyarm.policies.spec`; with the ending ``-tip`` the policy compensates the bending of the joints.
            A controller is proven again, like a controller file.
        control_period: time between two calls of `predict` [s]. None: 1 ms, until the reference in the first
            observations shows another period, for which the policy is then made again; see `Policy.predict`.
        robot: the arm of the policy: parameters of the two-joint arm, a `Robot`, the name of a shipped robot, a TOML
            file, or a folder of `fuzzyarm tune`. A controller file must have been designed for this arm, and a learned
            policy trained for it. Default: the arm of the controller's design, that of the folder of a tuned policy,
            otherwise Table 1.
        allow_unproven: accept a controller whose inequalities are not all proven, for experiments.

    Raises:
        ValueError: the name is unknown, or the file or folder is damaged, not proven or for another robot.
        OSError: the file cannot be read.

    Examples:
        >>> import numpy as np
        >>> policy = load_policy("computed-torque")
        >>> torque, state = policy.predict(np.zeros(10))
        >>> torque.shape, state.shape
        ((2,), (2,))
    """
    if control_period is None:
        policy = load_policy(name, control_period=1e-3, robot=robot, allow_unproven=allow_unproven)
        policy.remake = functools.partial(load_policy, name, robot=robot, allow_unproven=allow_unproven)
        return policy
    if not isinstance(name, str | os.PathLike):
        from fuzzyarm.policies._controller_policy import controller_policy

        return controller_policy(name, robot, control_period, allow_unproven)
    # A spec of code that may not be run raises, so the result is never a `UserPolicy`.
    return resolve(name).load(control_period, robot, allow_unproven)  # type: ignore[return-value]


def _is_code(name: str) -> bool:
    """Return whether a name refers to a foreign model, or is ``package.module:factory`` and not the name of a file."""
    if foreign(name):
        return True
    module, _, factory = name.partition(":")
    parts = (*module.split("."), *factory.split("."))
    return all(part.isidentifier() for part in parts) and not Path(name).exists()


def file_digest(file: Path) -> str:
    """Return the SHA-256 of a text file, with the line ends of every system replaced by line feeds."""
    from fuzzyarm.common.documents import read_bytes  # `import fuzzyarm` loads no msgspec

    return hashlib.sha256(read_bytes(file).replace(b"\r\n", b"\n")).hexdigest()


def recorded(name: str) -> str:
    """Return the name of a policy as files of results record it: without the leading folders of an absolute path."""
    if shield := resolve(name).shield:
        return shield.named(recorded(shield.law.name), recorded(shield.guest.name))
    if prefix := foreign(name):
        return prefix + recorded(name.removeprefix(prefix))
    path = Path(name)
    if not path.is_absolute():
        return name
    return str(Path(path.parent.name) / path.name) if resolve(name).tuned else path.name


def found_again(
    names: Sequence[str], files: Mapping[str, Collection[str]], given: Sequence[str], folder: Path
) -> tuple[str, ...]:
    """Return recorded names of policies, changed so that each can be loaded here.

    The search for a file or folder covers the names `given` by the user, then the recorded path from the current
    folder, then the folder `folder` of the results. `files` are the files of each policy by label, see
    `PolicySpec.files`. ValueError if a file or folder is in none of these places.
    """
    typed = {resolve(name).label: name for name in given}
    found = []
    for name in names:
        spec, beside = resolve(name), resolve(str(folder / name))
        if spec.label in typed:
            name = typed[spec.label]
        elif not (spec.named or spec.path is None or spec.path.exists()):
            if beside.path is not None and beside.path.exists():
                name = beside.name
            # The file of every learned policy is policy.json; loading a law without files reports an unknown name.
            elif {spec.path.name, "policy.json"} & set(files.get(spec.label, ())):
                raise ValueError(
                    f"policy {name} is neither in the current folder nor beside the results in {folder}: put it in one "
                    f"of these folders, or add --policy PATH/{Path(name).name}"
                )
        found.append(name)
    return tuple(found)
