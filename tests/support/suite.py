"""Runs the tests of a file, and prints one line for each: its result, its seconds, its name.

    suite.main(words)    words: classes or tests to run (default: all), and the options
        --host           the classes with HOST = True, which depend on how the machine schedules; without it the others.
                         Classes and tests that are named run in both cases. With --host, a test that fails is run once
                         more, and both results are printed
        --but=CLASS      not the tests of this class
        --smoke          only the tests that are marked @smoke: the sanitizers run these

With PALPATE_COVERAGE=DIR, programs that were built to count their functions write the counts of each test to
DIR/FILE/TEST (tests/coverage.py)."""
import os
import sys
import time
import unittest
from pathlib import Path


def smoke(test):
    """Marks a test that the sanitizers run: the shortest test of some code that no Catch2 test reaches."""
    test.smoke = True
    return test


def name_of(test):
    """Returns Class.test, without the module."""
    return ".".join(getattr(test, "test_case", test).id().split(".")[-2:])


class Lines(unittest.TestResult):
    """Prints a line for each test. Stores the tests that failed."""
    def __init__(self):
        super().__init__()
        self.passed = 0
        self.begun = time.monotonic()
        self.result = "passed"
        self.failed = {}     # name: test

    def startTest(self, test):
        super().startTest(test)
        count_functions_of(name_of(test))
        self.begun = time.monotonic()
        self.result = "passed"

    def stopTest(self, test):
        super().stopTest(test)
        count_functions_of("fixtures")
        self.passed += self.result == "passed"
        print(f"{self.result:7} {time.monotonic() - self.begun:8.3f} s  {name_of(test)}", flush=True)

    def report(self, test, error):
        self.result = "failed"
        case = getattr(test, "test_case", test)
        self.failed[name_of(test)] = case if isinstance(case, unittest.TestCase) else None
        print(f"{test.id()}: {self._exc_info_to_string(error, test)}", flush=True)

    def addFailure(self, test, err):
        super().addFailure(test, err)
        self.report(test, err)

    def addError(self, test, err):
        super().addError(test, err)
        self.report(test, err)

    def addSubTest(self, test, subtest, err):
        super().addSubTest(test, subtest, err)
        if err is not None:
            self.report(subtest, err)

    def addSkip(self, test, reason):
        super().addSkip(test, reason)
        self.result = "skipped"
        print(f"{test.id()}: skipped: {reason}", flush=True)
        if not isinstance(test, unittest.TestCase):   # a whole class
            print(f"skipped    0.000 s  {name_of(test)}", flush=True)


def count_functions_of(name):
    folder = os.environ.get("PALPATE_COVERAGE")
    if folder:
        os.environ["GCOV_PREFIX"] = str(Path(folder) / Path(sys.argv[0]).stem / name)


def cases_of(tests):
    for test in tests:
        if isinstance(test, unittest.TestSuite):
            yield from cases_of(test)
        else:
            yield test


def run(tests):
    result = Lines()
    count_functions_of("fixtures")
    unittest.TestSuite(tests).run(result)
    return result


def main(words=()):
    words = list(words)
    names = [word for word in words if not word.startswith("--")]
    module = sys.modules["__main__"]
    loader = unittest.defaultTestLoader
    tests = loader.loadTestsFromNames(names, module) if names else loader.loadTestsFromModule(module)
    host = "--host" in words
    chosen = [test for test in cases_of(tests) if names or getattr(test, "HOST", False) == host]
    chosen = [test for test in chosen if f"--but={type(test).__name__}" not in words]
    if "--smoke" in words:
        chosen = [test for test in chosen if hasattr(getattr(test, test._testMethodName), "smoke")]
    if not chosen:
        sys.exit("these names and options select no test")

    result = run(chosen)
    if host and result.failed and all(result.failed.values()):
        print("once more, as these tests depend on how the machine schedules:", ", ".join(result.failed), flush=True)
        again = run([type(test)(test._testMethodName) for test in result.failed.values()])
        sys.exit(0 if again.passed == len(result.failed) else 1)
    sys.exit(1 if result.failed else 0)
