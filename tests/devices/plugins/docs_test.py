#!/usr/bin/env python3
"""Tests that the commands of docs/plugins.md build plug-ins: docs_test.py SOURCE INCLUDE STUBS SAMPLE. INCLUDE has
palpate/, STUBS has the stubs' libraries, SAMPLE is the built sample plug-in."""
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

SOURCE, INCLUDE, STUBS, SAMPLE = (Path(a).resolve() for a in sys.argv[1:5])
PAGE = (SOURCE / "docs" / "plugins.md").read_text(encoding="utf-8")
LIBRARY = {"openhaptics": "HD", "dhd": "dhd", "nifalcon": "nifalcon"}


def symbols(file):
    out = subprocess.run(["nm", "-D", "--defined-only", file], check=True, stdout=subprocess.PIPE,
                         text=True).stdout
    # Templates of the standard library leave symbols in every program that uses them.
    return [line.split()[2] for line in out.splitlines() if line.split()[1] not in "WVu"]


def needed(file):
    out = subprocess.run(["objdump", "-p", file], check=True, stdout=subprocess.PIPE, text=True)
    return re.findall(r"NEEDED\s+(\S+)", out.stdout)


def sdks(folder):
    """Makes folders with the layout of the manufacturers' SDKs. Returns them by the page's variable names."""
    found = {}
    for name, library in LIBRARY.items():
        sdk = Path(folder, name)
        (sdk / "lib").mkdir(parents=True)
        (sdk / "include").symlink_to(
            SOURCE / "tests" / "devices" / "plugins" / "stub" / name / "include")
        (sdk / "lib" / f"lib{library}.so").symlink_to(STUBS / f"libpalpate_stub_{name}.so")
        found[name.upper()] = str(sdk)
    return found


class Page(unittest.TestCase):
    def test_the_sample_plugin_compiles_with_plugin_h_alone(self):
        block = re.search(r"^```sh\n(gcc .*?)^```$", PAGE, flags=re.S | re.M)[1]
        with tempfile.TemporaryDirectory() as folder:
            for name in ("sample.c", "plugin.h"):
                shutil.copy(SOURCE / "devices" / "plugins" / name, folder)
            env = {name: value for name, value in os.environ.items() if name != "CPATH"}
            subprocess.run(["bash", "-euc", block], cwd=folder, env={**env, "HOME": folder}, check=True)
            self.assertEqual(symbols(Path(folder, "sample.so")), ["palpate_plugin"])

    def test_the_commands_on_the_documentation_page_build_plugins(self):
        with tempfile.TemporaryDirectory() as folder:
            work = Path(folder, "work")
            shutil.copytree(SOURCE / "devices" / "plugins", work)
            env = {**os.environ, "CPATH": str(INCLUDE), "HOME": folder, **sdks(folder)}
            blocks = re.findall(r"^```sh\n(.*?)^```$", PAGE, flags=re.S | re.M)
            self.assertEqual(len(blocks), 4)
            for block in blocks:
                done = subprocess.run(["bash", "-euc", block], cwd=work, env=env, text=True,
                                      stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
                self.assertEqual((done.returncode, done.stdout), (0, ""), block)
            for name in ("sample", *LIBRARY):
                self.assertEqual(symbols(work / f"{name}.so"), ["palpate_plugin"], name)
            self.assertTrue(Path(folder, ".local/share/palpate/plugins/sample.so").exists())

    def test_cmake_builds_the_plugins_whose_sdk_is_given(self):
        with tempfile.TemporaryDirectory() as folder:
            given = sdks(folder)
            build = Path(folder, "build")
            (build / "include").mkdir(parents=True)
            (build / "include" / "palpate").symlink_to(SOURCE)
            Path(folder, "CMakeLists.txt").write_text(
                "cmake_minimum_required(VERSION 3.22)\nproject(lab C CXX)\n"
                "set(CMAKE_CXX_STANDARD 20)\n"
                f"include({SOURCE}/devices/plugins/sdk_plugins.cmake)\n", encoding="utf-8")

            def configure(*options):
                return subprocess.run(["cmake", "-S", folder, "-B", build, *options], text=True,
                                      stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
            done = configure("-DPALPATE_PLUGIN_SDKS=ON", f"-DPALPATE_DHD={given['DHD']}")
            self.assertEqual(done.returncode, 0, done.stdout)
            subprocess.run(["cmake", "--build", build], check=True, stdout=subprocess.DEVNULL)
            self.assertEqual([f.name for f in (build / "lib/palpate/plugins").iterdir()], ["dhd.so"])
            self.assertEqual(symbols(build / "lib/palpate/plugins" / "dhd.so"), ["palpate_plugin"])
            # The error names the wrong folder.
            done = configure(f"-DPALPATE_NIFALCON={folder}/nowhere")
            self.assertNotEqual(done.returncode, 0)
            self.assertIn("nowhere has no", " ".join(done.stdout.split()))

    def test_the_sample_plugin_links_only_system_libraries(self):
        self.assertEqual(symbols(SAMPLE), ["palpate_plugin"])
        self.assertLessEqual(set(needed(SAMPLE)), {"libc.so.6", "libm.so.6"})

    def test_the_constants_that_the_page_names_exist(self):
        for file, words in re.findall(r"\[(\w+\.cpp)\]\([^)]*\) \| [^|]* \| ([^|]*) \|", PAGE):
            text = (SOURCE / "devices" / "plugins" / file).read_text(encoding="utf-8")
            constants = re.findall(r"`(k\w+)`", words)
            self.assertGreater(len(constants), 0)
            for constant in constants:
                self.assertIn(constant, text, file)

    def test_every_limit_in_a_plugin_equals_a_row_of_the_known_arms(self):
        rows = (SOURCE / "devices" / "hid" / "known_arms.json").read_text(encoding="utf-8")
        known = {tuple(float(n) for n in row) for row in re.findall(
            r'"force": ([\d.]+), "stiffness": ([\d.]+), "damping": ([\d.]+), '
            r'"workspace_radius": ([\d.]+)', rows)}
        used = 0
        for name in LIBRARY:
            text = (SOURCE / "devices" / "plugins" / f"{name}.cpp").read_text(encoding="utf-8")
            found = re.findall(r'\{[\w" ]+, ([\d.]+), ([\d.]+), ([\d.]+), ([\d.]+), ', text)
            single = [re.search(rf"double {k} = ([\d.]+);", text)
                      for k in ("kForce", "kStiffness", "kDamping", "kRadius")]
            if all(single):
                found.append([match[1] for match in single])
            self.assertGreater(len(found), 0, name)
            for row in found:
                self.assertIn(tuple(float(n) for n in row), known, name)
                used += 1
        self.assertEqual(used, 11)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
