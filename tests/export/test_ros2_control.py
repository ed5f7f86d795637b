"""The example for ros2_control builds, and does what its page says, with stubs of the few classes that it needs."""

import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from fuzzyarm.cli import main

EXAMPLE = Path(__file__).parents[2] / "examples" / "ros2_control"


@pytest.mark.slow
@pytest.mark.skipif(not (shutil.which("cmake") and shutil.which("g++")), reason="no cmake or no g++ on this machine")
def test_the_controller_builds_and_holds_the_torques_when_a_sensor_drops_out(tmp_path):
    shutil.copytree(EXAMPLE, tmp_path / "src")
    assert main(["export", "c", "fuzzy-4-tip", "--out", str(tmp_path / "src" / "law")]) == 0
    build = str(tmp_path / "build")
    for words in (
        ["cmake", "-S", str(tmp_path / "src"), "-B", build, "-DSTUBS=ON", "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Werror"],
        ["cmake", "--build", build],
        ["ctest", "--test-dir", build, "--output-on-failure"],
    ):
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


def test_the_files_name_one_package_and_one_class():
    package, plugin = (ET.parse(EXAMPLE / name).getroot() for name in ("package.xml", "plugin.xml"))
    build, code = ((EXAMPLE / name).read_text(encoding="utf-8") for name in ("CMakeLists.txt", "controller.cpp"))
    name, (listed,) = package.findtext("name"), plugin.findall("class")
    assert f"project({name} " in build and plugin.get("path") == name
    assert f"PLUGINLIB_EXPORT_CLASS({listed.get('type')}, {listed.get('base_class_type')})" in code
