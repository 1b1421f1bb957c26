"""Writes an OpenFOAM case of a box as text."""

HEAD = """FoamFile
{{
    version 2.0;
    format ascii;
    class {kind};
    object {name};
}}
"""


def put(path, kind, body):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(HEAD.format(kind=kind, name=path.name) + body)


def box(folder, size, edge, fields, times=("0", "0.5", "1")):
    """Writes a box. `size` is the number of cells along x, y, z. `fields` is {name: (kind, dimensions, value(x, y, z,
    time))}, with a value per cell; a vector's value has three numbers."""
    nx, ny, nz = size

    def point(i, j, k):
        return (k * (ny + 1) + j) * (nx + 1) + i

    def cell(i, j, k):
        return (k * ny + j) * nx + i

    inner, outer = [], []
    for k in range(nz + 1):
        for j in range(ny + 1):
            for i in range(nx + 1):
                x = (point(i, j, k), point(i, j + 1, k), point(i, j + 1, k + 1), point(i, j, k + 1))
                y = (point(i, j, k), point(i, j, k + 1), point(i + 1, j, k + 1), point(i + 1, j, k))
                z = (point(i, j, k), point(i + 1, j, k), point(i + 1, j + 1, k), point(i, j + 1, k))
                for face, at, along in ((x, i, 0), (y, j, 1), (z, k, 2)):
                    others = [(i, nx), (j, ny), (k, nz)]
                    del others[along]
                    if any(p == n for p, n in others):
                        continue
                    here = (i, j, k)
                    back = tuple(c - (a == along) for a, c in enumerate(here))
                    if at == 0:
                        outer.append((face[::-1], cell(*here)))
                    elif at == size[along]:
                        outer.append((face, cell(*back)))
                    else:
                        inner.append((face, cell(*back), cell(*here)))
    inner.sort(key=lambda f: f[1:])
    mesh = folder / "constant" / "polyMesh"
    put(mesh / "points", "vectorField", f"{(nx + 1) * (ny + 1) * (nz + 1)}\n(\n" + "".join(
        f"({i * edge} {j * edge} {k * edge})\n" for k in range(nz + 1) for j in range(ny + 1)
        for i in range(nx + 1)) + ")\n")
    faces = [f[0] for f in inner] + [f[0] for f in outer]
    put(mesh / "faces", "faceList", f"{len(faces)}\n(\n" + "".join(
        "4(" + " ".join(map(str, f)) + ")\n" for f in faces) + ")\n")
    owners = [f[1] for f in inner] + [f[1] for f in outer]
    put(mesh / "owner", "labelList", f"{len(owners)}\n(\n" + "\n".join(map(str, owners)) + "\n)\n")
    put(mesh / "neighbour", "labelList",
        f"{len(inner)}\n(\n" + "\n".join(str(f[2]) for f in inner) + "\n)\n")
    put(mesh / "boundary", "polyBoundaryMesh",
        f"1\n(\nwalls\n{{\ntype wall;\nnFaces {len(outer)};\nstartFace {len(inner)};\n}}\n)\n")
    put(folder / "system" / "controlDict", "dictionary",
        f"startFrom startTime;\nstartTime 0;\nstopAt endTime;\nendTime {times[-1]};\ndeltaT 0.5;\n"
        "writeControl timeStep;\nwriteInterval 1;\nwriteFormat ascii;\n")
    centres = [tuple((c + 0.5) * edge for c in (i, j, k)) for k in range(nz) for j in range(ny)
               for i in range(nx)]
    for time in times:
        for name, (kind, dimensions, value) in fields.items():
            values = [value(*p, float(time)) for p in centres]
            words = "\n".join("(" + " ".join(map(repr, v)) + ")" if kind == "vector" else repr(v)
                              for v in values)
            put(folder / time / name, f"vol{kind.capitalize()}Field",
                f"dimensions {dimensions};\ninternalField nonuniform List<{kind}>\n{len(values)}\n"
                f"(\n{words}\n)\n;\nboundaryField\n{{\nwalls\n{{\ntype zeroGradient;\n}}\n}}\n")
    return folder
