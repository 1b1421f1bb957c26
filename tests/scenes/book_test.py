#!/usr/bin/env python3
"""Tests the README's first commands and the book's first pages: all blocks of commands run in the order of their page,
with the installed programs. Leaves out the line that only users need who have built palpate.

book_test.py BUILD. A block of JSON is the scene that the next commands name, and blocks of Python are the script that
they name. A block of text is output that the commands print. Blocks of console need an arm, and do not run. Builds
the book if mkdocs is installed, and the API reference if doxygen is installed.
"""
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
import suite  # noqa: E402

BUILD = Path(sys.argv[1]).resolve()
ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```(sh|json|python)\n(.*?)^```$", re.S | re.M)
SHOWN = re.compile(r"^```text\n(.*?)^```$", re.S | re.M)


OWN_BUILD = 'export PYTHONPATH=$(dirname "$(command -v palpate)")\n'  # for users who have built palpate


def script(page):
    """Returns a script of all commands and files on a page, for a user of the packages."""
    blocks = BLOCK.findall((ROOT / "docs" / page).read_text(encoding="utf-8"))
    lines = ["set -euo pipefail"]
    for at, (kind, text) in enumerate(blocks):
        if kind == "sh":
            lines.append(text.replace(OWN_BUILD, ""))
            continue
        rest = "".join(text for kind, text in blocks[at + 1:] if kind == "sh")
        end, into = (".py", ">>") if kind == "python" else (".json", ">")
        name = re.search(rf"[\w-]+\{end}\b", rest)[0]
        lines.append(f"cat {into}{name} <<'END'\n{text}END")
    return "\n".join(lines)


class Pages(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.prefix = Path(tempfile.mkdtemp())
        cls.addClassCleanup(shutil.rmtree, cls.prefix)
        subprocess.run(["cmake", "--install", BUILD, "--prefix", cls.prefix], check=True, stdout=subprocess.DEVNULL)
        cls.env = {**os.environ, "PATH": f"{cls.prefix / 'bin'}:/usr/bin:{os.environ['PATH']}"}
        for module in cls.prefix.rglob("palpate.cpython*.so"):  # the packages install the module where Python finds it
            cls.env["PYTHONPATH"] = str(module.parent)

    def run_page(self, page, *said, complaint=None):
        with tempfile.TemporaryDirectory() as folder:
            env = self.env
            done = subprocess.run(["bash", "-c", script(page)], cwd=folder, env=env, text=True,
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
            self.assertEqual(done.returncode, 0, done.stdout[-2000:])
            for words in said:
                self.assertRegex(done.stdout, words)
            printed = done.stdout.splitlines()
            for block in SHOWN.findall((ROOT / "docs" / page).read_text(encoding="utf-8")):
                for line in block.splitlines():
                    self.assertIn(line, printed)
            complaints = [line for line in printed if "palpate:" in line]
            self.assertEqual(len(complaints), 0 if complaint is None else 1, complaints)
            for line in complaints:
                self.assertRegex(line, complaint)

    def test_links_of_the_installed_pages_lead_to_installed_files(self):
        readme, = self.prefix.rglob("doc/palpate/README.md")
        pages = [readme, *readme.parent.rglob("book/**/*.md")]
        self.assertGreater(len(pages), 40)
        links = []
        for page in pages:
            text = re.sub(r"^```.*?^```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
            for target in re.findall(r"\]\(([^)\s#]+)", text):
                if not re.match("[a-z]+:", target):
                    links.append(target)
                    self.assertTrue((page.parent / target).exists(), f"{page}: {target}")
        for kept in ("book/felt.png", "book/embed.md", "programs/first_tick.cpp", "../programs/embed/device.cpp",
                     "../programs/session.py", "../plugins/openhaptics.cpp", "../README.md"):
            self.assertIn(kept, links)

    def test_the_commands_of_the_page_your_ct_succeed(self):
        self.run_page("your_ct.md", r"174696 active voxels", r"density_body: this grid marks the region of",
                      r"contact +skin: .* touch", r"contact +bone: .* touch",  # feel
                      r"\n0,0,0,1,40,", r"\n0,0,73,1,9\d\d\.", r"\n0,0,81,1,4\d\.", r"\n0,0,95,0,-1000,",  # sample
                      r"mode +skin: contact from .*yielded", r"mode +bone: contact from",  # press
                      r"because +skin holds",  # explain
                      r"contact +inner: .* touch")

    def test_commands_of_page_your_flow_succeed(self):
        self.run_page("your_flow.md", r"contact +stream: ", r"mode +tip: vortex_tube")

    def test_commands_of_page_your_arm_succeed(self):
        self.run_page("your_arm.md", r"profiles: polhem, ", r"status +1 fault, force off for 3000 ms",
                      complaint=r"^palpate: feel: the force was cut: the position jumped")

    def test_commands_of_page_your_script_succeed(self):
        self.assertIn(OWN_BUILD, (ROOT / "docs" / "your_script.md").read_text(encoding="utf-8"))
        needed = subprocess.run(["/usr/bin/python3", "-c", "import palpate, matplotlib"], check=False,
                                env=self.env, stderr=subprocess.DEVNULL)
        if needed.returncode != 0:
            self.skipTest("needs palpate's module for /usr/bin/python3, and matplotlib")
        self.run_page("your_script.md", r"the same to the last bit: True", r"forces differ by at most 0 N")

    def test_commands_of_page_questions_succeed(self):
        self.run_page("questions.md", r"because +", r"stability +")

    def test_the_first_commands_of_the_readme_succeed(self):
        first = re.search(r"^```sh\n(palpate import .*?)^```$", (ROOT / "README.md").read_text(encoding="utf-8"),
                          re.S | re.M)[1]
        expected = {"import": "scan.json", "view": "contact", "scene": "", "feel": "ticks", "devices": "polhem",
                    "sample": "0,0,0,1,", "-c": "class Scene"}
        with tempfile.TemporaryDirectory() as folder:
            def run(command):
                return subprocess.run(["bash", "-c", command], cwd=folder, env=self.env, text=True, check=False,
                                      stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                      timeout=300)

            # The reader's own files: the scan of the tutorial, a flow, and places.
            phantom = script("your_ct.md").partition("[ -e scan.nii.gz ]")
            made = run(f"{phantom[0]}python3 phantom.py\npalpate make wind-tunnel flow.vdb\n"
                       "printf 'x,y,z\\n0,0,0\\n' >places.csv")
            self.assertEqual(made.returncode, 0, made.stdout)
            for command in first.splitlines():
                command = command.partition("#")[0].rstrip()
                verb = command.split()[1]
                if verb == "-c" and "PYTHONPATH" not in self.env:  # the module is not built
                    continue
                if verb == "view":
                    if not (self.prefix / "bin" / "palpate-view").exists() or shutil.which("Xvfb") is None:
                        continue
                    command += " --seconds 1 --picture view.png"  # needs no display
                if "--device hid" in command and json.loads(run("palpate devices --json").stdout)["arms"]:
                    continue  # the test must not move a connected arm
                done = run(command)
                if "--device hid" in command:  # no arm is connected
                    self.assertEqual((done.returncode, done.stdout.count("\n")), (2, 1), done.stdout)
                    self.assertRegex(done.stdout, "^palpate: hid: no plugged-in arm")
                else:
                    self.assertEqual(done.returncode, 0, command + done.stdout)
                    self.assertIn(expected[verb], done.stdout)
            self.assertIn("follow", (Path(folder) / "flow.json").read_text(encoding="utf-8"))

    def test_commands_of_page_primitives_succeed(self):
        self.run_page("primitives.md", r'"proxy":\[0\.0015196')

    def test_the_pictures_of_primitives_are_drawn(self):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run(["/usr/bin/python3", str(ROOT / "bench" / "primitives_chart.py"), str(BUILD / "bin"),
                            folder], check=True)
            for name in ("primitives.png", "primitives.svg", "balance.png", "balance.svg"):
                self.assertGreater((Path(folder) / name).stat().st_size, 10000, name)


class Book(unittest.TestCase):
    def test_the_book_is_built_with_every_page(self):
        if shutil.which("mkdocs") is None:
            self.skipTest("needs mkdocs")
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(["mkdocs", "build", "--strict", "--quiet", "--site-dir", folder],
                                  cwd=ROOT, text=True, stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT, check=False)
            self.assertEqual(done.returncode, 0, done.stdout)
            listed = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
            for page in sorted((ROOT / "docs").glob("*.md")):
                self.assertIn(f": {page.name}\n", listed, "a page that the book does not list")
                self.assertTrue((Path(folder) / page.with_suffix(".html").name).exists())
            self.assertIn("Your CT in five minutes",
                          (Path(folder) / "index.html").read_text(encoding="utf-8"))


class Api(unittest.TestCase):
    def test_every_public_name_is_documented(self):
        if shutil.which("doxygen") is None:
            self.skipTest("needs doxygen")
        with tempfile.TemporaryDirectory() as folder:
            said = subprocess.run(["doxygen", "-"], cwd=ROOT, text=True, check=False,
                                  input=f"@INCLUDE = docs/Doxyfile\nOUTPUT_DIRECTORY = {folder}\n",
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
            self.assertEqual((said.returncode, said.stdout.replace(f"{ROOT}/", "")), (0, ""))
            self.assertTrue((Path(folder) / "html" / "structpalpate_1_1StepReport.html").exists())


if __name__ == "__main__":
    suite.main(sys.argv[2:])
