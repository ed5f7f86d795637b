"""A machine for PTX, thread by thread: each instruction is a line of Python, numbers are 64 bits."""

import ctypes
import functools
import re
import struct

import numpy as np

_WORD = 2**64 - 1
_LINE = re.compile(r"\s*(?:@(!?)(%\w+)\s+)?([a-z][\w.]*)\s*([^;]*);")
_REAL = {  # PTX ISA 7.8, section 9.7.3: the rounding is to the nearest, the even one of two
    "add.rn": "a + b", "sub.rn": "a - b", "mul.rn": "a * b", "div.rn": "a / b", "rcp.rn": "1.0 / a",
    "sqrt.rn": "np.sqrt(a)", "min": "least(a, b)", "max": "-least(-a, -b)",
}  # fmt: skip
_WHOLE = {
    "add": "a + b", "mul.lo": "a * b", "mad.lo": "a * b + c", "mul.wide": "a * b", "and": "a & b", "or": "a | b",
    "xor": "a ^ b", "shl": "a << b", "mov": "a", "cvta.to.global": "a", "cvta.local": "a", "not": "not a",
    "max": "max(signed(a), signed(b))", "min": "min(signed(a), signed(b))", "sub": "a - b", "neg": "-a",
}  # fmt: skip
_COMPARED = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}


def real(word):
    """Return the number with these 64 bits."""
    return np.float64(struct.unpack("d", struct.pack("Q", word))[0])


def word(number):
    """Return the 64 bits of a number."""
    return struct.unpack("Q", struct.pack("d", number))[0]


def signed(word):
    """Return a word as a whole number with a sign."""
    return word - 2**64 if word >> 63 else word


def least(a, b):
    """Return the smaller number: not nan if there is another, and -0 before 0."""
    if a != a or b != b:
        return b if a != a else a
    return a if a < b or (a == b and np.signbit(a)) else b


def toward_zero(number):
    """Return a whole number, the nearest there is where it has more than 64 bits."""
    return -(2**63) if number != number else min(max(int(np.clip(number, -1e19, 1e19)), -(2**63)), 2**63 - 1)


def _operand(text):
    if text.startswith("0d"):
        return str(int(text[2:], 16))
    if re.fullmatch(r"-?\d+", text):
        return str(int(text) & _WORD)
    return re.sub(r"\W", "_", text)


def _value(operation, operands):
    """Return the expression of what an instruction finds."""
    a, b, c = (*map(_operand, operands), "", "", "")[:3]
    name, _, kind = operation.rpartition(".")
    if operation.startswith("setp."):
        compared = name.removeprefix("setp.")
        if kind != "f64":
            pair = (f"signed({a})", f"signed({b})") if kind[0] == "s" else (a, b)
            return f"{pair[0]} {_COMPARED[compared]} {pair[1]}"
        known = f"(real({a}) == real({a}) and real({b}) == real({b}))"
        if compared in ("num", "nan"):
            return known if compared == "num" else f"not {known}"
        test = f"real({a}) {_COMPARED[compared[:2]]} real({b})"
        return f"{test} or not {known}" if compared.endswith("u") else f"{test} and {known}"
    if name == "selp":
        return f"{a} if {c} else {b}"
    if operation in ("abs.f64", "neg.f64"):
        return f"{a} & {_WORD >> 1}" if name == "abs" else f"{a} ^ {1 << 63}"
    if name == "shr":
        return f"{a} >> {b}" if kind[0] in "ub" else f"(signed({a}) >> {b}) & {_WORD}"
    if operation in ("cvt.rmi.f64.f64", "cvt.rni.f64.f64", "cvt.rzi.f64.f64"):
        rounded = {"rmi": "floor", "rni": "rint", "rzi": "trunc"}[name[4:7]]
        return f"word(np.{rounded}(real({a})))"
    if operation == "cvt.rzi.s64.f64":
        return f"toward_zero(real({a})) & {_WORD}"
    if operation in ("cvt.rn.f64.s64", "cvt.rn.f64.u64"):
        return f"word(float(signed({a})))" if kind == "s64" else f"word(float({a}))"
    if operation == "cvt.u64.u32":
        return a
    if kind == "f64":
        return "word(" + re.sub(r"\b[ab]\b", lambda one: f"real({a if one[0] == 'a' else b})", _REAL[name]) + ")"
    given = {"a": a, "b": b, "c": c}
    found = re.sub(r"\b[abc]\b", lambda one: given[one[0]], _WHOLE[name])
    return f"bool({found})" if kind == "pred" else f"({found}) & {_WORD}"


def _statement(operation, operands):
    """Return an instruction as a line of Python."""
    what = operation.split(".")
    if what[0] == "ret":
        return "return"
    if what[0] == "bra":
        return f"block = {operands[0]!r}; continue"
    if what[0] not in ("ld", "st"):
        return f"{_operand(operands[0])} = {_value(operation, operands[1:])}"
    place, numbers = (operands[-1], operands[:-1]) if what[0] == "ld" else (operands[0], operands[1:])
    base, _, offset = place.strip("[]").partition("+")
    if what[1] == "param":
        return f"{_operand(numbers[0])} = given[{base.rpartition('_')[2]}]"
    cells = [f"cell({_operand(base)} + {int(offset or 0) + 8 * k}).value" for k in range(len(numbers))]
    names = map(_operand, numbers)
    pairs = zip(names, cells, strict=True) if what[0] == "ld" else zip(cells, names, strict=True)
    return "; ".join(f"{to} = {of}" for to, of in pairs)


@functools.cache
def thread_of(text):
    """Return ``run(given, special, local)``, a thread of the only kernel of a module without functions.

    Of its parameters, the special registers by name, and the address of its local memory.
    """
    body, blocks = text[text.index("\n{") :], {"": []}
    own, special = blocks[""], sorted(set(re.findall(r"%n?(?:tid|ctaid)\.x", body)))
    for line in body.splitlines():
        line = line.partition("//")[0].replace("{", "").replace("}", "")
        if label := re.match(r"(\$\w+):", line):
            own.append(f"block = {label[1]!r}; continue")
            own = blocks[label[1]] = []
        elif found := _LINE.match(line):
            unless, condition, operation, operands = found.groups()
            test = f"if {'not ' if unless else ''}{_operand(condition)}: " if condition else ""
            own.append(test + _statement(operation, [one.strip() for one in operands.split(",")]))
    lines = ["def run(given, special, __local_depot0):", " block = ''"]
    lines += [f" {_operand(one)} = special[{one!r}]" for one in special]
    lines.append(" while True:")
    for label, statements in blocks.items():
        lines += [f"  if block == {label!r}:", *(f"   {one}" for one in statements or ["pass"])]
    names = {"cell": ctypes.c_uint64.from_address, "np": np}
    names |= {one.__name__: one for one in (real, word, signed, least, toward_zero)}
    exec("\n".join(lines), names)
    return names["run"]


def run_ptx(text, given, blocks, threads):
    """Run a kernel with these parameters on a grid of so many blocks with so many threads each."""
    size = re.search(r"\.local \.align \d+ \.b8\s+__local_depot0\[(\d+)\]", text)
    thread, given = thread_of(text), [one & _WORD for one in given]
    with np.errstate(all="ignore"):
        for block in range(blocks):
            for place in range(threads):
                local = np.full(int(size[1]) // 8 + 1 if size else 1, np.nan)
                special = {"%tid.x": place, "%ctaid.x": block, "%ntid.x": threads, "%nctaid.x": blocks}
                thread(given, special, local.ctypes.data)
