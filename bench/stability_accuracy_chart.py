#!/usr/bin/python3
"""Draws what palpate_bench_stability_accuracy measured.

    stability_accuracy_chart.py RESULT.json FOLDER [--doc FILE.md]

Writes stability_accuracy.png and .svg into FOLDER. The table goes to standard output, or into FILE.md between its
markers.
"""
import sys

sys.dont_write_bytecode = True
from charting import clear, number, plt, run, save, table, where  # noqa: E402

# Okabe and Ito's colours.
COLOURS = {"palpate": "#0072B2", "constraint approach": "#E69F00", "force function": "#8c8c8c",
           "Euler, fixed step": "#CC79A7", "Euler, adaptive step": "#D55E00",
           "Nelder-Mead": "#009E73", "smallest residual": "#56B4E9"}
FLOOR = 1e-9  # smaller errors are drawn here


def draw(data, folder):
    contacts = list(dict.fromkeys(r["contact"] for r in data["results"]))
    figure, axes = plt.subplots(1, len(contacts), figsize=(5.2 * len(contacts), 4.2), sharey=True,
                                squeeze=False)
    for ax, contact in zip(axes[0], contacts):
        clear(ax)
        for r in data["results"]:
            if r["contact"] != contact:
                continue
            x, y = r["cost_ns"], max(r["force_error"], FLOOR)
            colour = COLOURS.get(r["method"], "black")
            # One disc per rate. Its area is the stable stiffness relative to the formula for one wall (a circle), at
            # most 1.3.
            shares = [s["stiffness"] / s["formula"] for s in r["stable"]]
            for i, share in enumerate(shares):
                at = x * 1.35 ** (i - 1)
                ax.scatter([at], [y], s=110, facecolors="none", edgecolors=colour, linewidths=0.7)
                ax.scatter([at], [y], s=110 * min(1.3, share), color=colour, linewidths=0)
            below = r["method"] in ("palpate", "smallest residual")  # other labels would overlap these from above
            ax.annotate(r["method"], (x, y), textcoords="offset points",
                        xytext=(0, -16 if below else 9), ha="center", fontsize=8, color=colour)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_ylim(bottom=0.1 * FLOOR)
        ax.set_xlabel("a balance [ns], median")
        ax.set_title(contact, fontsize=10)
    axes[0][0].set_ylabel("error of the force, rms over rms")
    figure.suptitle("filled: largest stable stiffness over one wall's formula, at 1, 4 and 10 kHz",
                    fontsize=9)
    save(figure, folder, "stability_accuracy")


def tables(data):
    body = []
    for r in data["results"]:
        stable = ", ".join(number(s["stiffness"]) for s in r["stable"])
        body.append([r["contact"], r["method"], number(r["cost_ns"]), number(r["force_error"]), stable])
    rates = ", ".join(f"{s['rate'] / 1000:g}" for s in data["results"][0]["stable"])
    return (table(["on", "method", "balance [ns]", "force error", f"stable at {rates} kHz [N/m]"], body) +
            f"\n\n{where(data['machine'])}.")


if __name__ == "__main__":
    run(__doc__, draw, tables)
