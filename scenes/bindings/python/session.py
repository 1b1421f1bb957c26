"""A session with a volume, cell by cell (docs/notebook.md). Writes session.png."""

# %% A volume
import matplotlib.pyplot as plt
import numpy as np
import palpate

x = np.linspace(-40, 40, 81)  # mm: a soft ball of radius 30 mm, and in it a hard one of radius 14 mm
X, Y, Z = np.meshgrid(x, x, x, indexing="ij")
body = 30 - np.sqrt(X**2 + Y**2 + Z**2)
stone = 14 - np.sqrt((X - 4)**2 + Y**2 + (Z - 8)**2)
density = 300 / (1 + np.exp(-body)) + 900 / (1 + np.exp(-stone))

volume = palpate.volume(density.astype("float32"), spacing=1.0, origin=(-40, -40, -40), name="phantom")
# from a file: volume = palpate.Volume.load("head.vdb", "density")
info = volume.info
print(f"{info['active_voxels']} voxels, {info['lowest']:.0f} to {info['highest']:.0f}")

# %% A line through it
field = volume.field()
line = np.zeros((161, 3))
line[:, 2] = np.linspace(40, -40, 161)
value = field.sample(line)["value"]
for level in (150, 750):
    print(f"{level} is first reached at z = {line[np.argmax(value > level), 2]:g} mm")

# %% A scene
scene = palpate.Scene.parse({
    "palpate": 1,
    "volumes": {"phantom": {"place": {"scale": 0.001}}},  # mm to m
    "modes": [
        {"name": "skin", "mode": "isosurface", "of": "phantom", "value": 150, "strength": 0.8},
        {"name": "stone", "mode": "isosurface", "of": "phantom", "value": 750, "strength": 4, "friction": 0.3},
    ],
}, volumes={"phantom": volume})
told = scene.explain(at=(0, 0, 0.031), push=(0, 0, -0.0025))  # above the skin, and 1.5 mm into it
print(*scene.notes, *told["because"], sep="\n")

# %% A path
path = np.array([        # t [s], x, y, z [m]: down through the skin, across the stone, up
    (0.0, -0.008, 0, 0.036),
    (1.0, -0.008, 0, 0.018),
    (2.0, 0.014, 0, 0.016),
    (2.6, 0.014, 0, 0.036),
])
felt = scene.run(path, rate=1000)
probe, proxy, force = (np.stack([felt[f"{of}_{axis}"] for axis in "xyz"], axis=1)
                       for of in ("probe", "proxy", "force"))
size = np.linalg.norm(force, axis=1)
apart = np.linalg.norm(probe - proxy, axis=1)
print(f"{len(felt)} ticks, at most {size.max():.2f} N, median {np.median(felt['tick_ns']):.0f} ns a tick")

# %% Force over time, and the path over a slice
BLUE, ORANGE = "#0072B2", "#D55E00"  # colours of Okabe and Ito, which people with colour blindness can distinguish
figure, axes = plt.subplot_mosaic([["force", "slice"], ["apart", "slice"]], figsize=(9, 4), layout="constrained")
axes["force"].plot(felt["t"], size, color=BLUE)
axes["force"].set_ylabel("force [N]")
axes["force"].sharex(axes["apart"])
axes["apart"].plot(felt["t"], 1e3 * apart, color=ORANGE)
axes["apart"].set_ylabel("|probe - proxy| [mm]")
axes["apart"].set_xlabel("time [s]")
cut = axes["slice"]
shown = cut.imshow(density[:, 40, :].T, origin="lower", extent=(-40.5, 40.5, -40.5, 40.5), cmap="gray_r",
                   alpha=0.5)
cut.contour(x, x, density[:, 40, :].T, levels=[150, 750], colors="black", linewidths=0.8)
cut.plot(1e3 * probe[:, 0], 1e3 * probe[:, 2], "--", color=BLUE, label="probe")
cut.plot(1e3 * proxy[:, 0], 1e3 * proxy[:, 2], color=ORANGE, label="proxy")
cut.set(xlabel="x [mm]", ylabel="z [mm]", xlim=(-32, 32), ylim=(-32, 38))
cut.legend(loc="lower right")
figure.colorbar(shown, ax=cut, label="density")
figure.savefig("session.png", dpi=100)

# %% The volume in VTK, if it is installed
import importlib.util
import os

if importlib.util.find_spec("vtk"):
    import vtk
    image = field.to_vtk()
    renderer = vtk.vtkRenderer()
    for level, colour, opacity in ((150, "Tan", 0.3), (750, "White", 1.0)):
        shell = vtk.vtkFlyingEdges3D()
        shell.SetInputData(image)
        shell.SetValue(0, level)
        shell.Update()
        print(level, "has", shell.GetOutput().GetNumberOfPolys(), "triangles")
        mapper = vtk.vtkPolyDataMapper()
        mapper.SetInputConnection(shell.GetOutputPort())
        mapper.ScalarVisibilityOff()
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        actor.GetProperty().SetColor(vtk.vtkNamedColors().GetColor3d(colour))
        actor.GetProperty().SetOpacity(opacity)
        renderer.AddActor(actor)
    if os.environ.get("DISPLAY"):  # a window, which closes when q is pressed
        window = vtk.vtkRenderWindow()
        window.AddRenderer(renderer)
        hand = vtk.vtkRenderWindowInteractor()
        hand.SetRenderWindow(window)
        hand.Initialize()
        hand.Start()
else:
    print("VTK is missing: install python3-vtk9")
