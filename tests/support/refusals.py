"""Checks of programs that refuse an input."""
import os


def refusal(case, folder, call):
    """Runs `call`. Checks that it prints one line on stderr that begins with "palpate: ", prints nothing on stdout, and
    leaves no new file in `folder`. Returns its result and the line. The caller checks the exit status."""
    before = sorted(os.listdir(folder))
    done = call()
    lines = done.stderr.splitlines()
    case.assertEqual(len(lines), 1, done.stderr)
    case.assertTrue(lines[0].startswith("palpate: "), lines[0])
    case.assertEqual(done.stdout, "")
    case.assertEqual(sorted(os.listdir(folder)), before)
    return done, lines[0]
