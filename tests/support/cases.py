"""The number of random cases of a test, as in tests/support/random.h."""
import os


def cases(usual, name):
    """Returns PALPATE_CASES if it is a number, or a share of `usual` if it is a percentage such as "10%". If this room
    (PALPATE_ROOM) is listed in PALPATE_CHANGED, a percentage counts as at least 100."""
    text = os.environ.get("PALPATE_CASES", "100%")
    run = max(1, int(float(text[:-1]) * usual / 100 if text.endswith("%") else float(text)))
    if text.endswith("%") and os.environ.get("PALPATE_ROOM") in os.environ.get("PALPATE_CHANGED", "").split():
        run = max(run, usual)
    print(f"random cases: {run} of {usual}: {name}")
    return run
