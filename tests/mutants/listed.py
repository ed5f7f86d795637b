"""The mutants: in which file which line becomes which, and which tests have to fail then.

The list stays as it is: a mutant that lives asks for a sharper test, not for another mutant.
"""

# ruff: noqa: E501  a line for each mutant

from __future__ import annotations

from typing import NamedTuple

__all__ = ["MUTANTS", "Mutant"]


class Mutant(NamedTuple):
    """A change of one line.

    Attributes:
        name: in the results.
        file: of the package, below `fuzzyarm`.
        old: text within one line that stands in the file exactly once.
        new: what stands there instead.
        tests: arguments of pytest; at least one of these tests has to fail.
        equivalent: why no test can tell the difference; empty: it has to die.
    """

    name: str
    file: str
    old: str
    new: str
    tests: str
    equivalent: str = ""


CHECKS, DOCUMENTS, FILES, ARRAYS = (f"common/{name}.py" for name in ("checks", "documents", "files", "array_files"))
CONTROLLER, SCHEDULED, MODEL = (f"fuzzy_policy/{name}.py" for name in ("controller", "scheduled", "ts_model"))
PROOF, TIP = "proof", "proof/tip"

FORGED = "tests/abuse/test_forgeries.py -m slow -k 'not robot and not badly and not cell'"
ROBOT = "tests/abuse/test_forgeries.py -m slow -k robot"
BADLY = "tests/abuse/test_forgeries.py -m slow -k badly"
READ = "tests/abuse/test_readers.py -m slow -k"

MUTANTS = (
    # Checks of arguments.
    Mutant("real-open-end", CHECKS, "and above < number < below and", "and above <= number < below and", "tests/common/test_checks.py"),
    Mutant("real-too-large", CHECKS, "        number = math.inf", "        number = 1.0", "tests/common/test_checks.py"),
    Mutant("whole-truth", CHECKS, "if isinstance(value, _NO_NUMBERS) or not isinstance(value, numbers.Integral)", "if not isinstance(value, numbers.Integral)", "tests/common/test_checks.py"),
    Mutant("choice-kind", CHECKS, "if type(one) is type(value) and one == value", "if one == value", "tests/common/test_checks.py"),
    Mutant("interval-order", CHECKS, "    if first > last:", "    if False:", "tests/common/test_checks.py"),
    Mutant("array-infinite", CHECKS, "if not np.isfinite(result).all()", "if np.isnan(result).any()", "tests/common/test_checks.py"),
    Mutant("shown-lines", CHECKS, 'text = " ".join(text.split()) if "\\n" in text else text', "text = str(text)", "tests/common/test_checks.py"),
    # Documents and files.
    Mutant("document-size", DOCUMENTS, "    if len(content) > largest:", "    if len(content) > largest + 1:", "tests/common/test_documents.py"),
    Mutant("document-exchanged", DOCUMENTS, "if not stat.S_ISREG(os.fstat(handle).st_mode)", "if False", f"{READ} exchanged"),
    Mutant("document-infinite", DOCUMENTS, "_check_values(content, finite=True)", "_check_values(content, finite=False)", "tests/common/test_documents.py"),
    Mutant("document-twice", DOCUMENTS, "if len(content) < len(pairs)", "if len(content) > len(pairs)", "tests/common/test_documents.py"),
    Mutant("document-strict", DOCUMENTS, "msgspec.convert(content, kind, strict=True)", "msgspec.convert(content, kind, strict=False)", "tests/common/test_documents.py"),
    Mutant("document-depth", DOCUMENTS, "if isinstance(part, dict | list) and depth == _DEEPEST", "if isinstance(part, dict | list) and depth > _DEEPEST", "tests/common/test_documents.py"),
    Mutant("document-dotted", DOCUMENTS, "if run > _DEEPEST", "if run > 10**9", "tests/common/test_documents.py"),
    Mutant("file-left", FILES, "            part.unlink(missing_ok=True)", "            pass", "tests/common/test_files.py"),
    Mutant("folder-shared", FILES, "fcntl.LOCK_EX | fcntl.LOCK_NB", "fcntl.LOCK_SH | fcntl.LOCK_NB", "tests/common/test_files.py"),
    Mutant("arrays-bomb", ARRAYS, "    if total > most:", "    if False:", "tests/common/test_array_files.py -m slow -k bomb"),
    Mutant("arrays-header", ARRAYS, "if min(shape, default=0) < 0 or needed != left", "if min(shape, default=0) < 0 or needed > left", "tests/common/test_array_files.py", "the read after it asks for one byte more than the shape needs, and refuses what it gets: only the words differ"),
    Mutant("arrays-truth", ARRAYS, 'if array.dtype.kind == "b" and', 'if array.dtype.kind == "?" and', "tests/common/test_array_files.py -m slow -k neither"),
    # Controller files.
    Mutant("controller-digest", "fuzzy_policy/signed_files.py", 'if content["digest"] != _digest_of(', 'if not content["digest"] and _digest_of(', "tests/fuzzy_policy/test_controller.py"),
    Mutant("controller-hexadecimal", "fuzzy_policy/signed_files.py", "except OverflowError", "except ZeroDivisionError", BADLY),
    Mutant("controller-bounds", CONTROLLER, 'if not np.array_equal(np.array(decoded(document["bounds"])), model.bounds)', 'if not np.array(decoded(document["bounds"])).size', "tests/fuzzy_policy/test_controller.py"),
    Mutant("controller-blocks", CONTROLLER, "if not np.array_equal(self.P, self.P.T) or self.P[:n_e, n_e:].any()", "if not np.array_equal(self.P, self.P.T)", BADLY),
    Mutant("controller-weight", CONTROLLER, "self.weight.min() <= 0.0", "self.weight.min() < 0.0", BADLY),
    Mutant("controller-gamma", CONTROLLER, 'real("gamma", self.gamma, low=GAINS[0], high=GAINS[1])', 'real("gamma", self.gamma)', BADLY),
    Mutant("controller-pole", CONTROLLER, "above=alpha, high=RATES[1])", "above=0.0, high=RATES[1])", BADLY),
    # Proofs of the rigid arm.
    Mutant("definite-dominance", f"{PROOF}/definiteness.py", "sum((abs(x)", "sum((x", "tests/proof/test_definiteness.py"),
    Mutant("definite-symmetric", f"{PROOF}/definiteness.py", "    if not np.array_equal(matrix, matrix.T):", "    if False:", "tests/proof/test_definiteness.py"),
    Mutant("definite-stated", f"{PROOF}/definiteness.py", "rational(Fraction(repr(float(value))))", "rational(float(value))", "tests/proof/test_stated_numbers.py"),
    Mutant("certify-P", f"{PROOF}/certificate.py", 'claims = [Claim.of("P > 0", P)]', "claims: list[Claim] = []", FORGED),
    Mutant("certify-pair", f"{PROOF}/certificate.py", "                if i != j:", "                if i > j:", FORGED),
    Mutant("certify-gamma", f"{PROOF}/certificate.py", '"gamma2": gamma * gamma}', '"gamma2": gamma}', FORGED),
    Mutant("consistent-alpha", f"{PROOF}/_theorems.py", "[he(Q + alpha * P)],", "[he(Q)],", FORGED),
    Mutant("consistent-uncertain", f"{PROOF}/_theorems.py", "corner = corner + times(scale, H.T @ H)", "corner = corner + 0 * times(scale, H.T @ H)", FORGED),
    Mutant("consistent-input", f"{PROOF}/_theorems.py", "A @ P + B @ M - E", "A @ P - B @ M - E", "tests/synthesis/test_dissipation.py"),
    Mutant("theorem-1-input", f"{PROOF}/_theorems.py", "A @ P_11 + B @ M - E", "A @ P_11 - B @ M - E", "tests/synthesis/test_dissipation.py"),
    Mutant("theorem-2-sign", f"{PROOF}/_theorems.py", "-W @ (data.A_r @ P_22 + Q_12[", "-W @ (data.A_r @ P_22 - Q_12[", "tests/proof/test_theorems.py"),
    Mutant("model-range", MODEL, "(high - low) / 2 * slope[rows]", "(high - low) / 4 * slope[rows]", "tests/fuzzy_policy/test_ts_model.py"),
    Mutant("scheduled-share", f"{PROOF}/scheduled_certificate.py", '(("1/kappa", 1 / stated(controller.kappa)), ("1", fmpq(1)))', '(("1", fmpq(1)),)', ROBOT),
    Mutant("scheduled-slope", f"{PROOF}/inertia_bounds.py", 'for sign, mark in ((1, "-"), (-1, "+")):', 'for sign, mark in ((1, "-"),):', "tests/proof/test_scheduled_certificate.py -k every_claim"),
    Mutant("scheduled-rate", f"{PROOF}/scheduled_certificate.py", "+ 2 * rate * P", "+ rate * P", ROBOT),
    Mutant("cover-rounding", f"{PROOF}/box_cover.py", "self.shift = float(1.01", "self.shift = 0.0 * float(1.01", "tests/proof/test_inertia_polynomial.py"),
    Mutant("residual-slope", f"{PROOF}/_residual.py", "bound += (g + slope * reach).abs_upper()", "bound += g.abs_upper()", "tests/proof/test_residual.py"),
    # Proofs of the tip.
    Mutant("cells-proven", "policies/tip_files.py", "        if not cell.proven:", "        if False:", "tests/abuse/test_forgeries.py -m slow -k cell"),
    Mutant("cells-hole", "policies/tip_files.py", "hole = claim.plants.hole([cell.claim.plants for cell in found])", "hole = None", "tests/proof/tip/test_tube.py -k cells"),
    Mutant("zonotope-box", f"{TIP}/zonotope.py", "(np.abs(self.columns).sum(axis=1) + self.box) * ROUND_UP", "np.abs(self.columns).sum(axis=1) * ROUND_UP", "tests/proof/tip/test_enclosures.py"),
    Mutant("links-remainder", f"{TIP}/_remainders.py", "reshape(joints, joints) @ tube[of]", "reshape(joints, joints) @ (0.5 * tube[of])", "tests/proof/tip/test_enclosures.py"),
    # Other readers.
    Mutant("checkpoint-pickle", "rl_baselines/_checkpoint.py", 'map_location="cpu", weights_only=True', 'map_location="cpu", weights_only=False', "tests/rl_baselines/test_crafted_checkpoint.py"),
    Mutant("checkpoint-count", "rl_baselines/_checkpoint.py", 'whole("generators.numpy.position", drawn["position"], high=len(keys))', "len(keys)", "tests/rl_baselines/test_crafted_checkpoint.py"),
    Mutant("bundle-weights", "fuzzy_policy/laws/learned/bundle.py", "if hashlib.sha256(weights).hexdigest() != description.weights_sha256", "if not description.weights_sha256", f"{READ} 'bytes and weights'"),
    Mutant("sweep-identity", "eval/sweep/run.py", "if digest != _digest_of(then):", "if False:", f"{READ} exchanged"),
    Mutant("data-set-there", "eval/dataset/store.py", "    if folder.exists():", "    if False:", "tests/eval/dataset/test_dataset.py -m slow -k minari_loads"),
)  # fmt: skip
