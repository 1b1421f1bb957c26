"""What every refusal of a program looks like."""
import os


def refusal(case, folder, call):
    """Runs `call`: one clear line on stderr, nothing on stdout, no file left in `folder`. What
    `call` gave, and the line; its status is the caller's to check."""
    before = sorted(os.listdir(folder))
    done = call()
    lines = done.stderr.splitlines()
    case.assertEqual(len(lines), 1, done.stderr)
    case.assertTrue(lines[0].startswith("palpate: "), lines[0])
    case.assertEqual(done.stdout, "")
    case.assertEqual(sorted(os.listdir(folder)), before)
    return done, lines[0]
