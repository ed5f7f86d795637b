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
PROOF, TIP = "fuzzy_policy/proof", "eval/certified/tip"

FORGED = "tests/abuse/test_forgeries.py"
READ = "tests/abuse/test_readers.py"
APART = "tests/abuse/test_processes.py"

MUTANTS = (
    # Checks of arguments.
    Mutant("real-open-end", CHECKS, "and above < number < below and", "and above <= number < below and", "tests/common/test_checks.py"),
    Mutant("real-too-large", CHECKS, "        number = math.inf", "        number = 1.0", "tests/common/test_checks.py"),
    Mutant("whole-truth", CHECKS, "if isinstance(value, _NO_NUMBERS) or not isinstance(value, numbers.Integral)", "if not isinstance(value, numbers.Integral)", "tests/common/test_checks.py"),
    Mutant("choice-kind", CHECKS, "if type(one) is type(value) and one == value", "if one == value", "tests/common/test_checks.py"),
    Mutant("interval-order", CHECKS, "    if first > last:", "    if False:", "tests/common/test_checks.py"),
    Mutant("array-infinite", CHECKS, "if not np.isfinite(result).all()", "if np.isnan(result).any()", "tests/common/test_checks.py"),
    Mutant("shown-lines", CHECKS, 'text = " ".join(text.split()) if "\\n" in text else text', "text = str(text)", "tests/common/test_checks.py tests/abuse/test_documented_names.py"),
    # Documents and files.
    Mutant("document-size", DOCUMENTS, "    if len(content) > largest:", "    if len(content) > largest + 1:", "tests/common/test_documents.py"),
    Mutant("document-exchanged", DOCUMENTS, "if not stat.S_ISREG(os.fstat(handle).st_mode)", "if False", f"tests/common/test_documents.py {READ}"),
    Mutant("document-infinite", DOCUMENTS, "_check_values(content, finite=True)", "_check_values(content, finite=False)", "tests/common/test_documents.py"),
    Mutant("document-twice", DOCUMENTS, "if len(content) < len(pairs)", "if len(content) > len(pairs)", "tests/common/test_documents.py"),
    Mutant("document-strict", DOCUMENTS, "msgspec.convert(content, kind, strict=True)", "msgspec.convert(content, kind, strict=False)", "tests/common/test_documents.py"),
    Mutant("document-depth", DOCUMENTS, "if isinstance(part, dict | list) and depth == DEEPEST", "if isinstance(part, dict | list) and depth > DEEPEST", "tests/common/test_documents.py"),
    Mutant("document-dotted", DOCUMENTS, "if run > DEEPEST", "if run > 10**9", "tests/common/test_documents.py"),
    Mutant("file-left", FILES, "            part.unlink(missing_ok=True)", "            pass", "tests/common/test_files.py"),
    Mutant("folder-shared", FILES, "fcntl.LOCK_EX | fcntl.LOCK_NB", "fcntl.LOCK_SH | fcntl.LOCK_NB", "tests/common/test_files.py"),
    Mutant("arrays-bomb", ARRAYS, "    if total > most:", "    if False:", "tests/common/test_array_files.py"),
    Mutant("arrays-header", ARRAYS, "if min(shape, default=0) < 0 or needed != left", "if min(shape, default=0) < 0 or needed > left", "tests/common/test_array_files.py"),
    Mutant("arrays-truth", ARRAYS, 'if array.dtype.kind == "b" and', 'if array.dtype.kind == "?" and', f"tests/common/test_array_files.py {READ}"),
    # Controller files.
    Mutant("controller-digest", "fuzzy_policy/signed_files.py", 'if content["digest"] != digest_of(', 'if not content["digest"] and digest_of(', "tests/fuzzy_policy/test_controller.py"),
    Mutant("controller-hexadecimal", "fuzzy_policy/hexadecimal.py", "except OverflowError", "except ZeroDivisionError", f"tests/fuzzy_policy/test_controller.py {FORGED}"),
    Mutant("controller-bounds", CONTROLLER, "if not np.array_equal(np.array(decoded(document.bounds)), model.bounds)", "if not np.array(decoded(document.bounds)).size", "tests/fuzzy_policy/test_controller.py"),
    Mutant("controller-blocks", CONTROLLER, "if not np.array_equal(self.P, self.P.T) or self.P[:n_e, n_e:].any()", "if not np.array_equal(self.P, self.P.T)", FORGED),
    Mutant("controller-weight", CONTROLLER, "self.weight.min() <= 0.0", "self.weight.min() < 0.0", FORGED),
    Mutant("controller-gamma", CONTROLLER, 'real("gamma", self.gamma, low=GAINS[0], high=GAINS[1])', 'real("gamma", self.gamma)', FORGED),
    Mutant("controller-pole", CONTROLLER, "above=alpha, high=RATES[1])", "above=0.0, high=RATES[1])", FORGED),
    # Proofs of the rigid arm.
    Mutant("definite-dominance", f"{PROOF}/definiteness.py", "sum((abs(product[i, j])", "sum((product[i, j]", "tests/fuzzy_policy/proof/test_definiteness.py"),
    Mutant("definite-symmetric", f"{PROOF}/definiteness.py", "    if not np.array_equal(matrix, matrix.T):", "    if False:", "tests/fuzzy_policy/proof/test_definiteness.py"),
    Mutant("definite-stated", f"{PROOF}/definiteness.py", "rational(Fraction(repr(float(value))))", "rational(float(value))", "tests/fuzzy_policy/proof/test_stated_numbers.py"),
    Mutant("certify-P", f"{PROOF}/certificate.py", 'claims = [claim("P > 0", P)]', "claims: list[Claim] = []", FORGED),
    Mutant("certify-pair", f"{PROOF}/certificate.py", "                if i != j:", "                if i > j:", FORGED),
    Mutant("certify-gamma", f"{PROOF}/certificate.py", '"gamma2": gamma * gamma,', '"gamma2": gamma,', FORGED),
    Mutant("consistent-alpha", f"{PROOF}/consistent_reference.py", "[he(Q + alpha * P)],", "[he(Q)],", FORGED),
    Mutant("consistent-uncertain", f"{PROOF}/consistent_reference.py", "total = total + scale * (H.T @ H)", "total = total + 0 * scale * (H.T @ H)", FORGED),
    Mutant("theorem-2-sign", f"{PROOF}/theorem2.py", "-W @ (data.A_r @ P_22 + Q_12)", "-W @ (data.A_r @ P_22 - Q_12)", "tests/fuzzy_policy/proof/test_theorems.py"),
    Mutant("model-range", MODEL, "(high - low) / 2 * slope[rows]", "(high - low) / 4 * slope[rows]", FORGED),
    Mutant("scheduled-share", f"{PROOF}/scheduled_certificate.py", '(("1/kappa", 1 / stated(controller.kappa)), ("1", fmpq(1)))', '(("1", fmpq(1)),)', FORGED),
    Mutant("scheduled-slope", f"{PROOF}/inertia_bounds.py", 'for sign, mark in ((1, "-"), (-1, "+")):', 'for sign, mark in ((1, "-"),):', FORGED),
    Mutant("scheduled-rate", f"{PROOF}/scalar_loop.py", "+ 2 * rate * X + c.T @ c", "+ rate * X + c.T @ c", FORGED),
    Mutant("cover-rounding", f"{PROOF}/box_cover.py", "return cls(coefficients, both, float(shift), weight, matrix.size)", "return cls(coefficients, both, 0.0, weight, matrix.size)", "tests/fuzzy_policy/proof/test_inertia_polynomial.py"),
    Mutant("residual-slope", f"{PROOF}/residual.py", "bound += (g + slope * reach).abs_upper()", "bound += g.abs_upper()", "tests/fuzzy_policy/proof/test_residual.py"),
    # Proofs of the tip.
    Mutant("cells-proven", f"{TIP}/cells_file.py", "        if not cell.proven:", "        if False:", "tests/eval/certified/tip/test_tube.py -k cells"),
    Mutant("cells-hole", f"{TIP}/cells_file.py", "hole = missed(claim.plants, [cell.claim.plants for cell in found])", "hole = None", "tests/eval/certified/tip/test_tube.py -k cells"),
    Mutant("zonotope-box", f"{TIP}/zonotope.py", "(np.abs(self.columns).sum(axis=1) + self.box) * ROUND_UP", "np.abs(self.columns).sum(axis=1) * ROUND_UP", "tests/eval/certified/tip/test_enclosures.py"),
    Mutant("links-remainder", f"{TIP}/remainders.py", "total += spread @ tube[rows]", "total += 0.5 * spread @ tube[rows]", "tests/eval/certified/tip/test_enclosures.py"),
    # Other readers.
    Mutant("checkpoint-pickle", "rl_baselines/checkpoint.py", 'map_location="cpu", weights_only=True', 'map_location="cpu", weights_only=False', "tests/rl_baselines/test_crafted_checkpoint.py"),
    Mutant("checkpoint-count", "rl_baselines/checkpoint.py", 'whole("generators.numpy.position", drawn["position"], high=len(keys))', "len(keys)", "tests/rl_baselines/test_crafted_checkpoint.py"),
    Mutant("bundle-weights", "learned_policy/folder.py", "if hashlib.sha256(weights).hexdigest() != description.weights_sha256", "if not description.weights_sha256", READ),
    Mutant("sweep-identity", "eval/sweep/store.py", 'if digest != digest_of_identity(then) or then["numbers"] != json.loads(', 'if then["numbers"] != json.loads(', READ),
    Mutant("data-set-there", "eval/dataset/store.py", "    if folder.exists():", "    if False:", f"{APART} -k dataset"),
)  # fmt: skip
