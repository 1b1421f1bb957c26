"""Tests of loops that are on time, on machines that others use as well."""
import functools
import unittest

LATE = "the loop was late"
TRIES = 5


def unless_late(test):
    """What fails is tried anew, from setUp() on, where self.was_late(): a loop that is kept from its core cuts its
    force, which other hands see as well."""
    @functools.wraps(test)
    def tried(self):
        for _ in range(TRIES - 1):
            try:
                return test(self)
            except unittest.SkipTest:
                raise
            except Exception:  # pylint: disable=W0718
                if not self.was_late():
                    raise
                print(f"{test.__name__}: {LATE}: tried anew", flush=True)
            self.doCleanups()
            self.setUp()
        return test(self)
    return tried
