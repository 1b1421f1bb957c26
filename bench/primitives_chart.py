#!/usr/bin/python3
"""Draws the paper's figures 3 to 6. `palpate solve` computes each force and each proxy.

    primitives_chart.py BIN_DIR FOLDER

Writes figure 3 (primitives) and figures 4 to 6 (balance) into FOLDER, as .png and .svg."""
import json
import subprocess
import sys
from pathlib import Path

sys.dont_write_bytecode = True
from charting import clear, plt, prepare, save  # noqa: E402

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#8c8c8c"  # Okabe and Ito's
UP = [0, 0, 1]
MM = 1e-3


def solved(program, balances):
    """Returns, for each (stiffness, probe [m], primitives), the proxy [m] and the force on the hand [N]."""
    lines = "\n".join(json.dumps({"stiffness": k, "probe": p, "primitives": each})
                      for k, p, each in balances)
    done = subprocess.run([program, "solve"], input=lines + "\n", stdout=subprocess.PIPE, text=True,
                          check=True)
    return [(row["proxy"], row["force"]) for row in map(json.loads, done.stdout.splitlines())]


def draw_forces(program, folder):
    """Draws figure 3: the effect of each primitive on a proxy, with a spring so stiff that the proxy stays at the
    probe."""
    figure, axes = plt.subplots(1, 4, figsize=(12.4, 3.3), sharey=True)
    kinds = [("directed force", {"kind": "force", "direction": UP, "strength": 1}),
             ("point", {"kind": "point", "position": [0, 0, 0], "strength": 1}),
             ("line", {"kind": "line", "position": [0, 0, 0], "direction": [1, 0, 1], "strength": 1}),
             ("plane", {"kind": "plane", "position": [0, 0, 0], "direction": UP, "strength": 1})]
    places = [[x * MM, 0, z * MM] for x in range(-4, 5, 2) for z in range(-4, 5, 2)]
    for ax, (name, primitive) in zip(axes, kinds):
        clear(ax)
        ax.set_title(name, fontsize=10)
        if name == "point":
            ax.plot(0, 0, "o", color=ORANGE)
        elif name == "line":
            ax.plot([-5, 5], [-5, 5], color=ORANGE)
        elif name == "plane":
            ax.axhline(0, color=ORANGE)
            ax.axhspan(-5.5, 0, color=ORANGE, alpha=0.08)
        for place, (_, force) in zip(places, solved(program, [(1e5, p, [primitive]) for p in places])):
            x, z = place[0] / MM, place[2] / MM
            if max(abs(force[0]), abs(force[2])) < 1e-6:
                ax.plot(x, z, ".", color=GREY, ms=3)
                continue
            ax.annotate("", (x + 1.4 * force[0], z + 1.4 * force[2]), (x, z),
                        arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 1.1})
        ax.set_xlim(-5.5, 5.5)
        ax.set_ylim(-5.5, 5.5)
        ax.set_aspect("equal")
        ax.set_xlabel("x [mm]")
    axes[0].set_ylabel("z [mm]")
    save(figure, folder, "primitives")


def show(ax, probe, proxy, label=True):
    px, pz, qx, qz = probe[0] / MM, probe[2] / MM, proxy[0] / MM, proxy[2] / MM
    ax.plot([px, qx], [pz, qz], color=GREY, ls=":", lw=1.5)
    ax.plot(px, pz, "o", color=BLUE, mfc="white")
    ax.plot(qx, qz, "o", color=BLUE)
    if label:
        ax.annotate("probe", (px, pz), (6, -10), textcoords="offset points", fontsize=8)
        ax.annotate("proxy", (qx, qz), (-26, 6), textcoords="offset points", fontsize=8)


def draw_balances(program, folder):
    """Draws figures 4 to 6: a plane, a point and the spring; and a plane that the spring outweighs."""
    figure, (both, held, curve) = plt.subplots(1, 3, figsize=(12.4, 3.6))
    for ax in (both, held, curve):
        clear(ax)
    plane = {"kind": "plane", "position": [0, 0, 0], "direction": UP, "strength": 1}
    point = {"kind": "point", "position": [2 * MM, 0, MM], "strength": 0.6}
    probe = [MM, 0, -3 * MM]
    [(proxy, force)] = solved(program, [(500, probe, [plane, point])])
    both.axhline(0, color=ORANGE)
    both.axhspan(-3.5, 0, color=ORANGE, alpha=0.08)
    both.plot(2, 1, "o", color=GREEN)
    both.annotate("point, 0.6 N", (2, 1), (6, 4), textcoords="offset points", fontsize=8)
    both.annotate("plane, 1 N", (-0.4, 0), (0, 4), textcoords="offset points", fontsize=8)
    show(both, probe, proxy)
    both.annotate("", (probe[0] / MM + 0.7 * force[0], probe[2] / MM + 0.7 * force[2]),
                  (probe[0] / MM, probe[2] / MM),
                  arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 1.4})
    both.set_xlim(-0.5, 3.4)
    both.set_ylim(-3.5, 1.6)
    both.set_title("two primitives and the spring", fontsize=10)

    plane = {**plane, "strength": 2}
    depths = [1, 2.5, 4, 5, 6]
    held.axhline(0, color=ORANGE)
    held.axhspan(-6.6, 0, color=ORANGE, alpha=0.08)
    rows = solved(program, [(500, [0, 0, -d * MM], [plane]) for d in depths])
    for at, (depth, (proxy, force)) in enumerate(zip(depths, rows)):
        show(held, [at * MM, 0, -depth * MM], [at * MM, 0, proxy[2]], label=False)
        held.annotate(f"{force[2]:.2f} N", (at, -depth), (-14, -14), textcoords="offset points",
                      fontsize=8)
    held.set_xlim(-0.6, 4.6)
    held.set_ylim(-7.2, 1.2)
    held.set_xticks([])
    held.set_title("a plane of 2 N, pressed harder", fontsize=10)
    for ax in (both, held):
        ax.set_ylabel("z [mm]")
    both.set_xlabel("x [mm]")

    fine = [0.1 * i for i in range(81)]
    rows = solved(program, [(500, [0, 0, -d * MM], [plane]) for d in fine])
    curve.plot(fine, [force[2] for _, force in rows], color=BLUE, label="force [N]")
    curve.plot(fine, [-proxy[2] / MM for proxy, _ in rows], color=ORANGE, label="proxy's depth [mm]")
    curve.set_xlabel("probe's depth [mm]")
    curve.legend(frameon=False, fontsize=8)
    curve.set_title("held to 4 mm, then pushed through", fontsize=10)
    save(figure, folder, "balance")


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    program = str(Path(sys.argv[1]) / "palpate")
    folder = Path(sys.argv[2])
    prepare(folder)
    draw_forces(program, folder)
    draw_balances(program, folder)


if __name__ == "__main__":
    main()
