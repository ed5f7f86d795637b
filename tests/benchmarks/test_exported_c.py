"""What exported laws cost on Cortex-M: QEMU counts it, and headers state what was measured of their source."""

import json
import shutil

import numpy as np
import pytest
from slow_twins import slow_but
from support.exported import answers, bits, random_observations

from fuzzyarm import load_policy
from fuzzyarm.export.c_files import COSTS, sources_of

LAWS = json.loads(COSTS.read_text(encoding="utf-8"))["laws"]


@pytest.mark.slow
def test_qemu_counts_instructions_and_gives_the_bits_of_the_policy(module, tmp_path):
    """Install the toolchain with apt install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm."""
    if not (shutil.which("arm-none-eabi-gcc") and shutil.which("qemu-system-arm")):
        pytest.skip("no arm-none-eabi-gcc or no qemu-system-arm on this machine")
    policy, calls = load_policy("fuzzy-4"), 100
    seen = random_observations(policy, calls, 0)
    begins = np.arange(calls)[:, np.newaxis] % 50 == 0
    torque, _ = answers(policy, seen[:, np.newaxis], begins)
    rows = {}
    for core in module("exported_c").CORES:
        rows[core], found = module("exported_c").on_core(core, "double", policy, tmp_path, np.hstack([begins, seen]))
        np.testing.assert_array_equal(bits(found), bits(torque[:, 0]))
        stored = LAWS["fuzzy-4"][f"{core} double"]
        if rows[core]["flash"] == stored["flash"]:  # the same compiler
            assert rows[core]["stack"] == stored["stack"] and rows[core]["largest"] <= 1.01 * stored["largest"]
    assert 400 < rows["Cortex-M7"]["mean"] < rows["Cortex-M4F"]["mean"] / 10  # which has no double


@pytest.mark.parametrize("name", slow_but(["fuzzy-4"], LAWS))
def test_headers_state_what_was_measured_of_the_very_source(name):
    for number in {core.rpartition(" ")[2] for core in LAWS[name]}:
        header, _ = sources_of(name, load_policy(name), number).values()
        stated = " ".join(header.replace("\n *", " ").split())
        for core, row in LAWS[name].items():
            if core.endswith(number):
                assert f"{core.split()[0]}: {row['flash']} bytes of flash, {row['stack']} of stack" in stated
    assert "Cost: not measured" in next(iter(sources_of("another", load_policy("fuzzy-1"), "double").values()))


def test_the_package_has_the_costs_of_the_result(module):
    assert {row["law"]: row["cortex"] for row in module("measuring").stored("exported_c")["rows"]} == LAWS
