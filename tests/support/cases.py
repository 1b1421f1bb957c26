"""The number of random cases, as in random.h."""
import os


def cases(usual, name):
    """Returns the number of cases to run. PALPATE_CASES is a number, or a percentage of `usual` such as "10%"
    (default: 100%). For a room that has changed (PALPATE_ROOM in PALPATE_CHANGED), a percentage is at least 100 %."""
    text = os.environ.get("PALPATE_CASES", "100%")
    run = max(1, int(float(text[:-1]) * usual / 100 if text.endswith("%") else float(text)))
    if text.endswith("%") and os.environ.get("PALPATE_ROOM") in os.environ.get("PALPATE_CHANGED", "").split():
        run = max(run, usual)
    print(f"random cases: {run} of {usual}: {name}")
    return run
