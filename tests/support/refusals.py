"""Checks that all programs have in common when they refuse an input."""
import os


def refusal(case, folder, call):
    """Runs `call`: checks that it gives one clear line on stderr, no output on stdout, and leaves no file in
    `folder`. Returns the result of `call`, and the line. The caller checks the status."""
    before = sorted(os.listdir(folder))
    done = call()
    lines = done.stderr.splitlines()
    case.assertEqual(len(lines), 1, done.stderr)
    case.assertTrue(lines[0].startswith("palpate: "), lines[0])
    case.assertEqual(done.stdout, "")
    case.assertEqual(sorted(os.listdir(folder)), before)
    return done, lines[0]
