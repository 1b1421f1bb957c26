"""Tests of loops that are on time, on machines that others use as well."""
import functools
import unittest

LATE = "the loop was late"
TRIES = 5


def unless_late(test):
    """What fails is tried anew where self.was_late(), between its cleanups and setUp() (no tearDown()): a loop that is
    kept from its core cuts its force, which other hands see as well."""
    @functools.wraps(test)
    def tried(self):
        failed = None
        for n in range(TRIES):
            try:
                return test(self)
            except unittest.SkipTest:
                if failed is None:
                    raise
                raise failed from None
            except Exception as error:  # pylint: disable=W0718
                if n == TRIES - 1 or not self.was_late():
                    raise
                failed = error
                print(f"{test.__name__}: {LATE}: tried anew: {str(error)[:2000]}", flush=True)
            if not self.doCleanups():
                raise failed
            self.setUp()
    return tried
