"""Tests the Python module, with pytest: python_test.py needs PYTHONPATH on the module, and PALPATE_BIN on the
programs' folder."""

import json
import os
import pathlib
import pickle
import re
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import palpate
import pytest

BIN = os.environ["PALPATE_BIN"]
PAGE = pathlib.Path(__file__).parents[2] / "docs" / "python.md"
SKIN = {"name": "skin", "mode": "isosurface", "of": "ball", "value": 0, "solid": "above", "strength": 4}
SCENE = {"palpate": 1, "volumes": {"ball": {}}, "modes": [SKIN]}


def program(*words, **more):
    return subprocess.run([f"{BIN}/palpate", *map(str, words)], check=True, capture_output=True, text=True,
                          **more).stdout


def ball(n=49, dtype="f4"):
    """Returns the depth below the surface of a ball of radius 0.8, in a cube of edge 2."""
    x = np.linspace(-1, 1, n)
    r = np.sqrt(x[:, None, None]**2 + x[:, None]**2 + x**2)
    return palpate.volume((0.8 - r).astype(dtype), spacing=2 / (n - 1), origin=(-1, -1, -1), name="ball")


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """Writes the volumes two-bodies of `palpate make`. Returns their file."""
    folder = tmp_path_factory.mktemp("bodies")
    program("make", "two-bodies", folder / "bodies.vdb")
    return folder / "bodies.vdb"


def press(ticks=2000):
    """Returns the path of a hand that approaches along z, then slides."""
    path = np.zeros((ticks, 3))
    path[:, 2] = np.interp(np.arange(ticks), [0, ticks / 2, ticks], [0.05, 0.0375, 0.036])
    path[:, 0] = np.interp(np.arange(ticks), [0, ticks / 2, ticks], [0, 0, 0.01])
    return path


def test_parameter_smooth_is_a_standard_deviation_in_voxels_or_in_the_array_s_own_unit():
    values = np.zeros((21, 21, 21))
    values[10, 10, 10] = 1
    def along(smooth, **more):
        field = palpate.volume(values, smooth=smooth, **more).field()
        return field.sample([(10, 10, 10), (12, 10, 10)])["value"]
    peak, beside = along(1.5)
    assert beside / peak == pytest.approx(np.exp(-0.5 * (2 / 1.5) ** 2))
    assert list(along("1.5 file")) == [peak, beside]
    assert along(1)[0] == along(1.0)[0]
    stretched = palpate.volume(values, spacing=(0.5, 1, 1), smooth="1.5 file").field()
    a, b = stretched.sample([(5, 10, 10), (7, 10, 10)])["value"]
    assert b / a == pytest.approx(np.exp(-0.5 * (2 / 1.5) ** 2))


def test_an_array_s_values_are_placed_by_its_origin_and_spacing():
    values = np.arange(4 * 5 * 6, dtype="f8").reshape(4, 5, 6)
    for given in (values, np.asfortranarray(values), values[::-1][::-1], values.astype(">f8")):
        field = palpate.volume(given, spacing=(1, 2, 3), origin=(10, 20, 30)).field()
        rows = field.sample([(10 + i, 20 + 2 * j, 30 + 3 * k) for i, j, k in ((0, 1, 0), (3, 4, 5), (1, 2, 3))])
        assert list(rows["value"]) == [values[0, 1, 0], values[3, 4, 5], values[1, 2, 3]]
        assert rows["inside"].all()
    assert palpate.volume(values.tolist()).field().sample((3, 4, 5))["value"] == values[3, 4, 5]
    inner = field.sample((11.5, 24.5, 37))
    assert inner["gradient"].tolist() == pytest.approx([30, 3, 1 / 3])


def test_integers_become_floats_or_doubles_that_hold_their_values():
    counts = np.full((4, 4, 4), 7, "u2")
    counts[2, 2, 2] = 60001
    assert palpate.volume(counts).info["type"] == "float"
    many = counts.astype("i4")
    many[1, 1, 1] = 2**30 + 1
    volume = palpate.volume(many)
    assert volume.info["type"] == "double" and volume.info["highest"] == 2**30 + 1


def test_integers_that_a_double_cannot_hold_exactly_give_a_warning():
    counts = np.full((4, 4, 4), 7, "i8")
    counts[2, 2, 2] = 2**53
    counts[1, 1, 1] = -2**53
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert palpate.volume(counts).info["highest"] == 2**53
        counts[2, 2, 2] += 1
        with pytest.raises(UserWarning, match="counts: integers with a magnitude above 9,007,199,254,740,992 are "
                                              "rounded"):
            palpate.volume(counts, name="counts")
    for value, dtype in ((-2**53 - 1, "i8"), (2**64 - 1, "u8")):
        with pytest.warns(UserWarning, match="are rounded"):
            palpate.volume(np.where(np.eye(4)[:, :, None] > 0, np.array(value, dtype), np.array(7, dtype)))


def test_a_mode_of_a_label_of_an_array_holds_the_hand_at_the_voxels_faces():
    labels = np.zeros((30, 30, 30))
    labels[5:25, 5:25, 5:25] = 7
    labels[5:15, 5:25, 5:25] = 3
    volumes = {"organs": palpate.volume(labels, background=0, name="organs")}
    scene = {"palpate": 1, "coupling": {"stiffness": 500}, "volumes": {"organs": {"place": {"scale": 0.001}}},
             "modes": [{"mode": "isosurface", "of": "organs", "label": 7, "strength": 3}]}
    hand = np.full((500, 3), 0.015)
    hand[:, 0] = np.linspace(0.03, 0.0235, 500)
    parsed = palpate.Scene.parse(scene, volumes)
    force = parsed.run(hand)["force_x"][-1]
    assert force == pytest.approx(0.5, abs=0.01)
    assert parsed.notes == []
    assert parsed.explain((0.026, 0.015, 0.015), (-0.002, 0, 0))["modes"]
    assert volumes["organs"].info["labels"] == {}
    scene["modes"][0]["label"] = [7, 9]
    with pytest.raises(palpate.Error, match="no voxel with the label 9: choose from 3, 7"):
        palpate.Scene.parse(scene, volumes)


def test_a_mask_that_becomes_the_background_gives_a_warning():
    mask = np.zeros((20, 20, 20), "u1")
    mask[:, :, :15] = 1
    with pytest.warns(UserWarning, match="cut: its highest value is the median of its faces"):
        assert palpate.volume(mask, name="cut").info["active_voxels"] == 2000
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert palpate.volume(mask, background=0).info["active_voxels"] == 6000
        noise = np.random.default_rng(3).normal(size=(20, 20, 20))
        assert palpate.volume(noise, smooth=1).info["highest"] < noise.max()
        mask[1:, 1:, 1:] = 0
        mask[5:10, 5:10, 5:10] = 1
        assert palpate.volume(mask[1:, 1:, 1:]).info["active_voxels"] == 125
    with pytest.raises(palpate.Error, match="all its values equal the background"):
        palpate.volume(np.ones((5, 5, 5)))


def test_the_matrix_of_a_nifti_image_defines_the_axes_of_an_array():
    affine = np.array([[0, -2, 0], [1, 0, 0], [0, 0, 3]], float)
    values = np.random.default_rng(2).normal(size=(5, 6, 7))
    field = palpate.volume(values, spacing=affine, origin=(1, 2, 3)).field()
    places = np.array([(4, 1, 2), (0, 5, 6)])
    rows = field.sample(places @ affine.T + (1, 2, 3))
    assert rows["value"] == pytest.approx([values[4, 1, 2], values[0, 5, 6]])


def test_a_volume_of_vectors_gives_their_jacobian():
    x = np.linspace(-1, 1, 9)
    X, Y, Z = np.meshgrid(x, x, x, indexing="ij")
    field = palpate.volume(np.stack([-Y, X, 0 * Z + 1], axis=-1), spacing=0.25, origin=(-1, -1, -1)).field()
    assert field.vector
    row = field.sample((0.1, 0.2, 0.3))
    assert row["value"].tolist() == pytest.approx([-0.2, 0.1, 1])
    assert row["jacobian"].ravel().tolist() == pytest.approx([0, -1, 0, 1, 0, 0, 0, 0, 0], abs=1e-9)


def test_a_sample_from_python_equals_that_of_palpate_sample(bodies, tmp_path):
    volume = palpate.Volume.load(bodies, "cloud")
    low, high = np.array(volume.info["bounds"])
    points = np.random.default_rng(3).uniform(low, high, (500, 3))
    np.savetxt(tmp_path / "p.csv", points, "%.17g", ",", header="x,y,z", comments="")
    for how in ("trilinear", "cubic"):
        text = program("sample", bodies, "--grid", "cloud", "--points", tmp_path / "p.csv", "--interpolation", how)
        table = np.array([line.split(",") for line in text.splitlines()[1:]], float)
        rows = volume.field(how).sample(points)
        assert (rows["inside"] == table[:, 3]).all()
        assert (rows["value"] == table[:, 4]).all()
        assert (rows["gradient"] == table[:, 5:8]).all()
    assert rows.shape == (500,) and volume.field().sample(points.reshape(50, 10, 3)).shape == (50, 10)


def test_a_run_from_python_equals_that_of_palpate_feel(bodies, tmp_path):
    scene = palpate.Scene.load(bodies)
    path = np.array([(0, 0, 0, 0.06), (0.5, 0.01, 0, 0.02), (1.5, -0.02, 0.01, -0.01), (1.6, 0, 0, 0.05)])
    np.savetxt(tmp_path / "path.csv", path, "%.17g", ",", header="t,x,y,z", comments="")
    program("feel", bodies, "--device", f"path:{tmp_path}/path.csv", "--rate", 2000, "--trace", tmp_path / "t.csv")
    told = [line.split(",") for line in (tmp_path / "t.csv").read_text().splitlines()]
    rows = scene.run(path, 2000)
    # Additional columns of the trace are loads of modes.
    columns = [name for name in told[0] if not name.startswith("load_")]
    assert list(rows.dtype.names) == columns == told[0][:len(columns)]
    assert len(rows) == len(told) - 1 == 3201
    for column, name in enumerate(columns):
        texts = [row[column] for row in told[1:]]
        if name == "status":
            assert rows[name].tolist() == texts
        elif name != "tick_ns":
            assert (rows[name] == np.array(texts, float)).all(), name
    assert np.abs(rows["force_z"]).max() > 0.3


def test_an_explanation_from_python_equals_that_of_palpate_explain(bodies):
    told = json.loads(program("explain", bodies, "--at", "0,0,0.04", "--push", "0.001,0,-0.002", "--json"))
    answer = palpate.Scene.load(bodies).explain((0, 0, 0.04), (0.001, 0, -0.002))
    assert answer == told
    assert answer["modes"] and answer["because"]
    mine = palpate.Scene.parse(SCENE, {"ball": ball()}).explain((0, 0, 0.041), (0, 0, -0.004))
    assert mine["force"] and mine["modes"][0]["name"] == "skin"
    with pytest.raises(palpate.Error, match="x, y, z|three numbers"):
        palpate.Scene.load(bodies).explain(0, (0, 0, 1))


def test_single_steps_from_python_give_the_same_forces_as_a_run():
    scene = palpate.Scene.parse(SCENE, {"ball": ball()})
    path = press()
    rows = scene.run(path)
    hand = scene.hand()
    forces = np.array([hand.step(*p) for p in path])
    told = np.stack([rows["force_x"], rows["force_y"], rows["force_z"]], axis=-1)
    assert forces == pytest.approx(told, abs=1e-9)
    assert forces[-1, 2] > 0.5
    assert hand.report["status"] == "converged" and hand.fault == ""
    assert hand.proxy == hand.report["proxy"]
    # The scene's hand runs at 1 kHz.
    assert np.array([scene.step(*p) for p in path]) == pytest.approx(forces, abs=0)


def growing_ball(folder, play):
    """Returns a scene with a sequence of 4 frames: a ball with a radius of 8 mm, which grows by 1 mm every 0.1 s."""
    axis = np.arange(32) - 15.5
    r = np.sqrt(axis[:, None, None]**2 + axis[:, None]**2 + axis**2)
    for i in range(4):
        (folder / f"ball_{i}.nrrd").write_bytes(
            b"NRRD0004\ntype: float\ndimension: 3\nsizes: 32 32 32\nencoding: raw\nendian: little\n"
            b"space: left-posterior-superior\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n"
            b"space origin: (-15.5,-15.5,-15.5)\n\n" + (100 * (8 + i - r)).astype("<f4").tobytes())
        program("import", folder / f"ball_{i}.nrrd", folder / f"ball_{i}.vdb")
    return {"palpate": 1, "coupling": {"stiffness": 500}, "play": play,
            "volumes": {"ball": {"file": str(folder / "ball_%d.vdb"), "frames": {"rate": 10},
                                 "place": {"scale": 0.001}}},
            "modes": [SKIN]}


@pytest.mark.parametrize("kind", ["sequence", "bricks"])
def test_an_explanation_of_a_sequence_or_of_bricks_equals_that_of_palpate_explain(tmp_path, kind):
    scene = growing_ball(tmp_path, {"from": 0.1})
    if kind == "bricks":
        program("brick", tmp_path / "ball_0.vdb", tmp_path / "ball.bricks")
        del scene["play"]
        scene["volumes"]["ball"] = {"file": str(tmp_path / "ball.bricks"), "place": {"scale": 0.001}}
    file = tmp_path / "scene.json"
    file.write_text(json.dumps(scene))
    told = json.loads(program("explain", file, "--at", "0.012,0,0", "--push", "-0.006,0,0", "--json"))
    assert told["force"]["size"] > 0.1
    assert palpate.Scene.load(file).explain((0.012, 0, 0), (-0.006, 0, 0)) == told


def test_sequences_play_from_the_scene_s_time_at_its_speed(tmp_path):
    scene = growing_ball(tmp_path, {"from": 0.1, "speed": 0.5})
    hand = np.zeros((401, 3))
    hand[:, 0] = np.interp(np.arange(401), [0, 80], [0.015, 0.007])
    rows = palpate.Scene.parse(scene).run(hand)
    # Play starts at 0.1 s, at half speed. So the radius is 9 mm at first and grows by 5 mm/s.
    for t in (0.1, 0.2, 0.3, 0.4):
        assert rows["proxy_x"][round(1000 * t)] == pytest.approx(0.009 + 0.005 * t, abs=5e-5)
    by_steps = palpate.Scene.parse(scene)
    forces = np.array([by_steps.step(*p) for p in hand])
    assert forces[:, 0] == pytest.approx(rows["force_x"], abs=1e-9)


def test_a_seek_blends_frames_over_50_ms_and_a_time_set_by_the_script_does_not(tmp_path):
    scene = palpate.Scene.parse(growing_ball(tmp_path, {"from": 0.1, "paused": True}))

    def pressed():
        hand = scene.hand()
        for x in np.linspace(0.015, 0.007, 100):
            hand.step(x, 0, 0)
        assert hand.proxy[0] == pytest.approx(0.009, abs=5e-5)
        return hand

    hand = pressed()
    hand.seek(0.2)  # the next frame: its ball is 1 mm larger
    reached = []
    for _ in range(80):
        hand.step(0.007, 0, 0)
        reached.append(hand.proxy[0])
    # The first tick shows the old frame. Then the radius grows by 1 mm over 50 ms.
    assert reached[0] == pytest.approx(0.009, abs=1e-4)
    assert reached[25] == pytest.approx(0.0095, abs=1e-4)
    assert reached[-1] == pytest.approx(0.010, abs=5e-5)
    assert np.diff(reached).max() < 5e-5
    set_by_script = pressed()
    for seconds in (0.1, 0.2, 0.2, 0.2):
        set_by_script.step(0.007, 0, 0, play=seconds)
    assert set_by_script.proxy[0] == pytest.approx(0.010, abs=2e-4)
    # A seek before the first tick sets the start of play, within the scene's range.
    early = scene.hand()
    early.seek(0.0)
    for x in np.linspace(0.015, 0.007, 100):
        early.step(x, 0, 0)
    assert early.proxy[0] == pytest.approx(0.009, abs=5e-5)
    for wrong in (float("nan"), float("inf"), -2e9):
        with pytest.raises(palpate.DeviceError, match="seek: it is not a time within 1e9 s"):
            hand.seek(wrong)


def saved_volumes(bodies):
    """Returns volumes by kind, each with the largest allowed error of its values in 16 bits. None: not tested."""
    flow = np.random.default_rng(69).normal(size=(21, 9, 70, 3)).astype("f4")
    return {"float": (ball(), 1e-3), "double": (ball(dtype="f8"), 1e-3),
            "vector": (palpate.volume(flow, spacing=(1, 2, 0.5), name="flow"), 5e-3),
            "file": (palpate.Volume.load(bodies, "cloud"), None)}


@pytest.mark.parametrize("kind", ["float", "double", "vector", "file"])
@pytest.mark.parametrize("name", ["saved.vdb", "saved.bricks"])
def test_a_saved_volume_has_the_same_samples_when_it_is_loaded(kind, name, bodies, tmp_path):
    volume, rounding = saved_volumes(bodies)[kind]
    low, high = np.array(volume.info["bounds"])
    points = np.random.default_rng(4).uniform(low, high, (500, 3))
    told = volume.field().sample(points)
    volume.save(tmp_path / name)
    again = palpate.Volume.load(tmp_path / name)
    assert again.name == volume.name and again.info["bounds"] == volume.info["bounds"]
    assert again.info["active_voxels"] == volume.info["active_voxels"]
    rows = again.field().sample(points)
    assert (rows["inside"] == told["inside"]).all() and told["inside"].any()
    if kind == "double" and name == "saved.bricks":
        assert rows["value"] == pytest.approx(told["value"], abs=1e-6)
    else:
        assert (rows["value"] == told["value"]).all()
    assert [entry.name for entry in tmp_path.iterdir()] == [name]  # no partial file
    if rounding is None:
        return
    volume.save(tmp_path / f"half-{name}", half=True)
    halved = palpate.Volume.load(tmp_path / f"half-{name}")
    assert halved.field().sample(points)["value"] == pytest.approx(told["value"], abs=rounding)
    assert (halved.field().sample(points)["value"] != told["value"]).any()
    # A volume that was loaded from 16 bits keeps its values, and the first volume keeps its 32 bits.
    halved.save(tmp_path / f"again-{name}")
    twice = palpate.Volume.load(tmp_path / f"again-{name}")
    assert (twice.field().sample(points)["value"] == halved.field().sample(points)["value"]).all()
    if name == "saved.vdb":
        volume.save(tmp_path / name)
        assert (palpate.Volume.load(tmp_path / name).field().sample(points)["value"] == told["value"]).all()


def test_bricks_that_python_saves_equal_those_of_palpate_brick(tmp_path):
    volume = ball()
    volume.save(tmp_path / "ball.vdb")
    program("brick", tmp_path / "ball.vdb", tmp_path / "told.bricks", "--half")
    volume.save(tmp_path / "ball.bricks", half=True)

    def contents(folder):
        return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    assert contents(tmp_path / "ball.bricks") == contents(tmp_path / "told.bricks")
    scene = palpate.Scene.load(tmp_path / "ball.bricks")
    assert list(scene.fields) == ["ball"]


def test_a_volume_that_cannot_be_saved_is_refused_and_leaves_no_file(tmp_path):
    volume = ball()
    volume.save(tmp_path / "ball.bricks")
    volume.save(tmp_path / "ball.bricks")  # the same bricks again: the folder stays unchanged
    with pytest.raises(palpate.Error) as caught:
        ball(33).save(tmp_path / "ball.bricks")
    assert "ball.bricks" in caught.value.what and "\n" not in str(caught.value)
    with pytest.raises(palpate.Error, match="grid, fill and smooth"):
        palpate.Volume.load(tmp_path / "ball.bricks", smooth=1)
    with pytest.raises(palpate.Error, match="no-such-folder"):
        volume.save(tmp_path / "no-such-folder" / "ball.vdb")
    (tmp_path / "folder.vdb").mkdir()
    with pytest.raises(palpate.Error, match="it is a folder"):
        volume.save(tmp_path / "folder.vdb")
    loud = palpate.volume(np.where(np.eye(9)[:, :, None] > 0, 7e4, np.zeros((9, 9, 9))).astype("f4"), name="loud")
    (tmp_path / "loud.vdb").write_bytes(b"before")
    with pytest.raises(palpate.VolumeError, match="too large for 16 bits"):
        loud.save(tmp_path / "loud.vdb", half=True)
    assert (tmp_path / "loud.vdb").read_bytes() == b"before"
    with pytest.raises(palpate.Error, match="too large for 16 bits"):
        loud.save(tmp_path / "loud.bricks", half=True)
    assert not list(tmp_path.glob("*.partial*"))
    loud.save(tmp_path / "loud.vdb")
    assert palpate.Volume.load(tmp_path / "loud.vdb").info["highest"] == 7e4


def test_other_threads_run_while_a_volume_is_saved(tmp_path):
    volume = palpate.volume(np.random.default_rng(1).normal(size=(160, 160, 160)).astype("f4"))
    saver = threading.Thread(target=volume.save, args=(tmp_path / "noise.vdb",))
    saver.start()
    n = 0
    while saver.is_alive():
        n += 1
        time.sleep(0)
    saver.join()
    assert n > 100
    assert palpate.Volume.load(tmp_path / "noise.vdb").info["active_voxels"] == volume.info["active_voxels"]


def test_a_fault_stays_until_it_is_cleared():
    hand = palpate.Scene.parse(SCENE, {"ball": ball()}).hand()
    assert hand.step(0, 0, 0.05) == (0, 0, 0) and hand.fault == ""
    assert hand.step(float("nan"), 0, 0.05) == (0, 0, 0) and hand.fault != ""
    assert hand.step(0, 0, 0.05) == (0, 0, 0) and hand.report["status"] == "fault"
    hand.clear()
    hand.step(0, 0, 0.05)
    assert hand.fault == "" and hand.report["status"] == "converged"


def test_a_scene_accepts_the_numbers_of_numpy():
    plain = {**SCENE, "volumes": {"ball": {"place": {"scale": 0.05, "translate": [0, 0, 0.01]}}},
             "modes": [{**SKIN, "strength": {"piecewise": [[0, 0], [1, 4]]}}]}
    numpys = {**SCENE, "palpate": np.int64(1),
              "volumes": {"ball": {"place": {"scale": np.float64(0.05),
                                             "translate": np.array([0, 0, 0.01], np.longdouble)}}},
              "modes": [{**SKIN, "strength": {"piecewise": np.array([[0, 0], [1, 4]])}}]}
    volumes = {"ball": ball(9)}
    told = [palpate.Scene.parse(scene, volumes).explain((0, 0, 0.05), (0, 0, -0.002)) for scene in (plain, numpys)]
    assert told[0] == told[1]
    assert list(numpys["volumes"]["ball"]) == ["place"]  # the script's dict must not change


def deep(levels=100000):
    scene = []
    for _ in range(levels):
        scene = [scene]
    return scene


@pytest.mark.parametrize("wrong, why", [
    ({**SCENE, "modes": {1, 2}}, "a set is not a number"),
    ({**SCENE, (1, 2): 3}, "keys must be"),
    ({**SCENE, "palpate": 1j}, "a complex is not a number"),
    ({**SCENE, "palpate": float("nan")}, "Out of range float"),
    (deep(), "recursion"),
    ("{ no", "it is not valid JSON (parse error at line 1, column 4"),
    ("\udc80", "surrogates not allowed"),
    ('{"modes": [], "modes": []}', "occurs twice"),
])
@pytest.mark.parametrize("with_volume", [False, True])
def test_an_invalid_scene_is_refused_with_its_reason(wrong, why, with_volume):
    with pytest.raises(palpate.SceneError) as caught:
        palpate.Scene.parse(wrong, {"ball": ball(9)} if with_volume else {})
    error = caught.value
    assert error.what == "scene" and why in error.why and why not in error.remedy


def alone(script):
    """Returns the output of a script in a new Python process."""
    return subprocess.run([sys.executable, "-c", SCRIPT + script], check=True, capture_output=True, text=True,
                          timeout=300).stdout


SCRIPT = """
import resource, signal, threading, time
import numpy as np
import palpate
def scene():
    x = np.linspace(-1, 1, 9)
    r = np.sqrt(x[:, None, None]**2 + x[:, None]**2 + x**2)
    ball = palpate.volume(0.8 - r, spacing=0.25, origin=(-1, -1, -1))
    return palpate.Scene.parse({"palpate": 1, "volumes": {"ball": {}}, "modes": [
        {"mode": "isosurface", "of": "ball", "value": 0, "solid": "above", "strength": 4}]}, {"ball": ball})
"""


def test_a_run_from_python_takes_less_than_1_5_times_the_memory_of_its_rows():
    rows, more = alone("""
felt = scene().run([(0, 0, 0, 0.05), (1, 0, 0, 0.05)])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
felt = scene().run([(0, 0, 0, 0.05), (400, 0, 0, 0.05)])
print(felt.nbytes, 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before))
""").split()
    assert int(rows) > 5e7 and int(more) < 1.5 * int(rows)


def test_a_run_that_needs_too_much_memory_is_refused():
    told = alone("""
s = scene()
resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
try:
    s.run([(0, 0, 0, 0.05), (99999, 0, 0, 0.05)])
except palpate.Error as e:
    print(e)
""")
    assert told == ("memory: the call needs more memory than is available: "
                    "split the work into smaller calls, or use smaller volumes\n")


@pytest.mark.parametrize("work", [
    "palpate.volume(values, smooth=32)",
    "s.fields['ball'].sample(np.zeros((20000000, 3)))",
    "s.run([(0, 0, 0, 0.05), (8000, 0, 0, 0.05)])",
])
def test_ctrl_c_ends_a_long_call(work):
    # Measures the thread's processor time after the interruption, which does not depend on the machine's load.
    told = alone(f"""
s = scene()
values = np.random.default_rng(1).normal(size=(160, 160, 160)).astype("f4")
own = time.pthread_getcpuclockid(threading.get_ident())
pressed = []
def press():
    signal.raise_signal(signal.SIGINT)
    pressed.append(time.clock_gettime(own))
timer = threading.Timer(0.3, press)
timer.start()
try:
    {work}
except KeyboardInterrupt:
    ended = time.clock_gettime(own)
    timer.join()
    print("interrupted", ended - pressed[0])
""")
    assert told.startswith("interrupted")
    assert float(told.split()[1]) < 0.2


@pytest.mark.parametrize("after", [0.0, 0.01, 0.05, 0.2])
@pytest.mark.parametrize("work", [
    "palpate.volume(values, smooth=32)",
    "s.fields['ball'].sample(np.zeros((20000000, 3)))",
    "s.run([(0, 0, 0, 0.05), (8000, 0, 0, 0.05)])",
])
def test_a_script_ends_without_an_error_while_its_thread_computes(work, after):
    assert alone(f"""
s = scene()
values = np.zeros((112, 112, 112), "f4")
values[50:60] = 1
def work():
    {work}
threading.Thread(target=work, daemon=True).start()
time.sleep({after})
print("ends")
""") == "ends\n"


def test_a_second_ctrl_c_ends_python():
    done = subprocess.run([sys.executable, "-c", SCRIPT + """
values = np.random.default_rng(1).normal(size=(200, 200, 200)).astype("f4")
threading.Timer(0.3, signal.raise_signal, [signal.SIGINT]).start()
try:
    palpate.volume(values, smooth=16)
except KeyboardInterrupt:
    print("once", flush=True)
import os
os.system(f"(while sleep 0.2; do kill -INT {os.getpid()} || exit; done) >/dev/null 2>&1 &")
"""], capture_output=True, text=True, check=False)
    assert done.stdout == "once\n" and done.returncode == -2


def test_other_threads_run_during_a_run():
    scene = palpate.Scene.parse(SCENE, {"ball": ball()})
    path = np.repeat(press(), 150, axis=0)
    done = threading.Event()
    counted = []

    def count():
        n = 0
        while not done.is_set():
            n += 1
            time.sleep(0)
        counted.append(n)

    other = threading.Thread(target=count)
    other.start()
    scene.run(path)
    done.set()
    other.join()
    assert counted[0] > 100


def test_a_scene_gives_its_fields_volumes_bounds_and_notes():
    volume = ball()
    scene = palpate.Scene.parse({**SCENE, "volumes": {"ball": {"place": {"fit": 0.2}}}}, {"ball": volume})
    assert list(scene.fields) == ["ball"] and scene.volumes["ball"].info == volume.info
    low, high = np.array(scene.bounds)
    assert high - low == pytest.approx(0.2, rel=0.05)
    field = scene.fields["ball"]
    assert field.sample((0.0, 0.0, 0.0))["value"] == pytest.approx(0.8, abs=1e-6)
    assert scene.notes == [] and scene.source == "scene"


def test_to_vtk_returns_an_image_with_the_field_s_values():
    pytest.importorskip("vtkmodules.vtkCommonDataModel")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    field = ball().field()
    image = field.to_vtk(0.125)
    values = vtk_to_numpy(image.GetPointData().GetArray("ball"))
    points = np.array([image.GetPoint(i) for i in range(image.GetNumberOfPoints())])
    assert (values == field.sample(points)["value"]).all()
    assert image.GetPointData().GetScalars().GetName() == "ball"
    with pytest.raises(palpate.Error, match="10\\^9 points"):
        field.to_vtk(1e-5)


def test_a_balance_from_python_equals_that_of_palpate_solve():
    planes = [palpate.Primitive("plane", direction=d, strength=2) for d in ((0, 0, 1), (1, 0, 1))]
    answer = palpate.solve(500, (0, 0, -1e-3), planes)
    line = ('{"stiffness":500,"probe":[0,0,-0.001],"primitives":['
            '{"kind":"plane","position":[0,0,0],"direction":[0,0,1],"strength":2},'
            '{"kind":"plane","position":[0,0,0],"direction":[1,0,1],"strength":2}]}')
    told = json.loads(program("solve", input=line))
    assert list(answer["proxy"]) == told["proxy"] and list(answer["force"]) == told["force"]
    assert answer["status"] == told["status"] == "converged"
    assert planes[1].direction == pytest.approx((2**-0.5, 0, 2**-0.5))


@pytest.mark.parametrize("wrong, kind, what", [
    (lambda: palpate.Scene.load("/no/such.json"), palpate.SceneError, "/no/such.json"),
    (lambda: palpate.Scene.parse("{"), palpate.SceneError, "scene"),
    (lambda: palpate.Scene.parse("{", {"ball": ball()}), palpate.SceneError, "scene"),
    (lambda: palpate.Scene.parse([], {"ball": ball()}), palpate.SceneError, "scene"),
    (lambda: palpate.Scene.parse({"palpate": 1, "volumes": 3, "modes": []}, {"ball": ball()}), palpate.SceneError,
     "scene"),
    (lambda: palpate.Scene.parse({**SCENE, "modes": [{**SKIN, "strenght": 1}]}, {"ball": ball()}),
     palpate.SceneError, "scene: /modes/0/strenght"),
    (lambda: palpate.Scene.parse({**SCENE, "volumes": {"bal": {}}}, {"ball": ball()}), palpate.SceneError,
     "scene: /volumes/bal"),
    (lambda: palpate.Volume.load("/no/such.vdb"), palpate.VolumeError, "/no/such.vdb"),
    (lambda: palpate.volume(np.zeros((3, 3))), palpate.VolumeError, "values"),
    (lambda: palpate.volume(np.zeros((3, 3, 3)), name="flat"), palpate.VolumeError, "flat"),
    (lambda: palpate.volume(np.zeros((3, 3, 3), complex)), palpate.VolumeError, "values"),
    (lambda: palpate.volume(np.full((3, 3, 3), np.nan), name="holes"), palpate.VolumeError, "holes"),
    (lambda: palpate.volume(np.ones((3, 3, 3)), spacing=0), palpate.VolumeError, "values"),
    (lambda: palpate.volume(np.ones((3, 3, 3)), spacing=(1, 2)), palpate.VolumeError, "values"),
    (lambda: palpate.volume(np.ma.masked_less(np.ones((3, 3, 3)), 2)), palpate.VolumeError, "values"),
    (lambda: palpate.volume([1, [2]]), palpate.VolumeError, "values"),
    (lambda: palpate.volume(np.ones((3, 3, 3)), spacing="wide"), palpate.VolumeError, "values"),
    (lambda: palpate.volume(np.ones((3, 3, 3)), origin=(0, 0, np.nan)), palpate.Error, "origin"),
    (lambda: palpate.volume(np.ones((3, 3, 3, 3)), background=1), palpate.VolumeError, "values"),
    (lambda: palpate.Volume.load("/no/such\nvolume.vdb"), palpate.VolumeError, "/no/such\\nvolume.vdb"),
    (lambda: palpate.volume(np.ones((3, 3, 3)), smooth=33), palpate.Error, "smooth"),
    (lambda: palpate.volume(np.ones((3, 3, 3)), smooth="1 mm"), palpate.Error, "smooth"),
    (lambda: palpate.Scene.parse(SCENE, {"ball": ball(9)}).explain((0, 0, 0), (0, 0, np.nan)), palpate.Error, "push"),
    (lambda: ball(9).field("linear"), palpate.Error, "interpolation"),
    (lambda: ball(9).field().sample(np.zeros((3, 2))), palpate.Error, "points"),
    (lambda: palpate.Scene.parse(SCENE, {"ball": ball(9)}).run(np.zeros((3, 5))), palpate.DeviceError, "path"),
    (lambda: palpate.Scene.parse(SCENE, {"ball": ball(9)}).run([(0, 0, np.nan)]), palpate.DeviceError, "path row 0"),
    (lambda: palpate.Scene.parse(SCENE, {"ball": ball(9)}).run([(0, 0, 0, 0), (0, 0, 0, 1)]), palpate.DeviceError,
     "path row 1"),
    (lambda: palpate.Scene.parse(SCENE, {"ball": ball(9)}).run(press(), 1), palpate.Error, "rate"),
    (lambda: palpate.solve(0, (0, 0, 0), []), palpate.Error, "solve"),
    (lambda: palpate.Primitive("wall"), palpate.Error, "kind"),
    (lambda: palpate.Primitive("plane", direction=(0, 0, 0)), palpate.Error, "direction"),
    (lambda: palpate.Primitive("plane", strength=-1), palpate.Error, "strength"),
])
def test_errors_of_the_python_module_name_their_cause_and_remedy(wrong, kind, what):
    with pytest.raises(palpate.Error) as caught:
        wrong()
    error = caught.value
    assert type(error) is kind and what in error.what
    assert str(error) == f"{error.what}: {error.why}: {error.remedy}" and "\n" not in str(error)
    assert error.why and error.remedy
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind and again.args == error.args


def test_the_version_of_the_python_module_equals_that_of_the_program():
    commit = f" ({palpate.__commit__})" if palpate.__commit__ else ""
    assert program("--version").startswith(f"palpate {palpate.__version__}{commit}\n")


def test_the_examples_on_the_page_about_python_run_without_errors(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 6
    names = {}
    for block in blocks:
        exec(compile(block, PAGE.name, "exec"), names)
    said = capsys.readouterr().out
    touched, force = map(float, re.search(r"touched at ([0-9.]+) m, then ([0-9.]+) N", said).groups())
    assert 0.018 < touched < 0.022 and 0.5 < force < 3.01
    assert "converged no fault" in said
    assert (tmp_path / "press.png").stat().st_size > 5000
