#!/usr/bin/python3
"""Measures and draws the effect of a network's delay and loss on a hand.

    network_chart.py BUILD FOLDER

Left and middle: a hand in a volume of bricks that a web server sends, through real TCP and palpate_relay (the bowl of
tests/scenes/http_test.py). Left: the share of ticks that read coarse bricks. Middle: the force error of these runs,
relative to a replay with bricks from a folder. Right: the distance between two linked hands, in virtual time
(palpate_loop_tests "a hand follows*"). Writes network.png and .svg into FOLDER; a table of left and middle goes to
standard output. Takes minutes."""
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.dont_write_bytecode = True
BUILD, FOLDER = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
ROOT = Path(__file__).resolve().parents[1]
sys.argv = ["http_test.py", str(BUILD / "bin"), str(BUILD / "tests/palpate_relay")]
sys.path += [str(ROOT / "tests/scenes"), str(ROOT / "tests/support")]
import http_test  # noqa: E402
from charting import clear, number, plt, prepare, save, table  # noqa: E402
from recordings import rows_of  # noqa: E402

DELAYS = (0, 5, 20, 50, 100)  # ms each way
LOSSES = (0, 1, 5)  # %
COLOURS = ("#0072B2", "#009E73", "#D55E00")  # Okabe and Ito's


def through_a_window():
    """Returns for each loss, one pair for each delay: the share of ticks with coarse bricks [%], and the rms error of
    the force over the run [N]."""
    http_test.Far.setUpClass()
    far = http_test.Far("felt")
    found = {}
    for loss in LOSSES:
        for n, delay in enumerate(DELAYS):
            for seed in range(20):
                told, _ = far.felt(1000 * loss + 100 * n + seed, "--loss", str(loss / 100), delay=delay)
                if not told["faults"]:
                    break
            again = far.dir / "again.rec"
            (far.dir / "again.json").write_text(far.scene(str(far.dir / "bowl")).read_text())
            http_test.run("feel", far.dir / "again.json", "--device", f"replay:{far.dir / 'far.rec'}", "--record", again)
            off = rows_of(far.dir / "far.rec")["wanted"] - rows_of(again)["wanted"]
            error = float(np.sqrt(np.mean(np.sum(off * off, axis=1))))
            found.setdefault(loss, []).append((100 * told["coarse_share"], error))
    far.doCleanups()
    http_test.Far.doClassCleanups()
    return found


def linked():
    """Returns for each loss, one pair for each delay: the delay and the distance of two hands [mm]."""
    said = subprocess.run([BUILD / "tests/palpate_loop_tests", "a hand follows*"], check=True, capture_output=True,
                          text=True, timeout=60).stdout
    found = {}
    for delay, loss, apart in re.findall(r"^ *(\d+) +(\d+): ([\d.]+)$", said, re.MULTILINE):
        found.setdefault(int(loss), []).append((int(delay), float(apart)))
    return found


def main():
    prepare(FOLDER)
    window, hands = through_a_window(), linked()
    figure, (coarse, error, apart) = plt.subplots(1, 3, figsize=(10.2, 3.0))
    for colour, loss in zip(COLOURS, LOSSES):
        coarse.plot(DELAYS, [row[0] for row in window[loss]], "o-", markersize=3, color=colour, label=f"{loss} % lost")
        error.plot(DELAYS, [row[1] for row in window[loss]], "o-", markersize=3, color=colour, label=f"{loss} % lost")
    for colour, (loss, rows) in zip(COLOURS, sorted(hands.items())):
        apart.plot(*zip(*rows), "o-", markersize=3, color=colour, label=f"{loss} % lost")
    for ax, title in ((coarse, "coarse ticks of bricks by HTTP [%]"), (error, "their force error, rms [N]"),
                      (apart, "two linked hands apart, rms [mm]")):
        ax.set_title(title, fontsize=9)
        ax.set_xlabel("delay each way [ms]")
        ax.set_ylim(bottom=0)
        ax.legend(fontsize=7, frameon=False)
        clear(ax)
    save(figure, FOLDER, "network")
    print(table(["delay ms"] + [f"coarse %, {loss} % lost" for loss in LOSSES] + [f"N, {loss} %" for loss in LOSSES],
                [[delay] + [number(window[loss][n][k]) for k in (0, 1) for loss in LOSSES]
                 for n, delay in enumerate(DELAYS)]))


main()
