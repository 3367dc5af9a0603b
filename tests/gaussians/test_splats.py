"""3DGS' .ply: read independently, from other programs, damaged; and that it renders what was saved."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from random_gaussians import scene, view
from tolerances import DRAWN_OR_NOT, FAR_POSITION, FLOAT32_SCALAR, FLOAT32_VALUE, LEVEL_8BIT

from dofbench.core.errors import InputError
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import AppearanceOptions, rasterise
from dofbench.training.gaussians.splats import lower_degree, read_offset, read_splats, write_splats

FIELDS = (
    ["x", "y", "z", "nx", "ny", "nz"]
    + [f"f_dc_{k}" for k in range(3)]
    + [f"f_rest_{k}" for k in range(45)]
    + ["opacity"]
    + [f"scale_{k}" for k in range(3)]
    + [f"rot_{k}" for k in range(4)]
)
ROW = np.dtype([(name, "<f4") for name in FIELDS])


def independently(path) -> np.ndarray:
    """What a viewer does: lines up to end_header, then rows of float32."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    rows = np.frombuffer(body, ROW)
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    assert lines[3:] == [f"property float {name}" for name in FIELDS]
    return rows


def picture(gaussians: Gaussians, **options):
    with torch.no_grad():
        return rasterise(gaussians, view(60, 50), AppearanceOptions(**options), geometry="full")


def test_an_independent_reader_finds_every_number_in_its_place(tmp_path):
    parameters, filter_3d = scene(40, 1, rest=8), torch.linspace(0, 0.2, 40)
    parameters["quaternions"][3] = 0
    write_splats(tmp_path / "a.ply", Gaussians(parameters, filter_3d))
    rows = independently(tmp_path / "a.ply")
    assert np.array_equal([rows[axis] for axis in "xyz"], parameters["means"].T)
    assert not any(rows[name].any() for name in ("nx", "ny", "nz"))
    for channel in range(3):
        assert np.array_equal(rows[f"f_dc_{channel}"], parameters["sh_dc"][:, channel])
        for k in range(15):
            expected = parameters["sh_rest"][:, k, channel] if k < 8 else torch.zeros(40)
            assert np.array_equal(rows[f"f_rest_{15 * channel + k}"], expected)
    rotation = torch.nn.functional.normalize(parameters["quaternions"].double(), dim=1)
    rotation[3] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    assert np.allclose([rows[f"rot_{k}"] for k in range(4)], rotation.T, atol=FLOAT32_SCALAR)
    # Mip-Splatting's 3D filter is in the scales and the opacity.
    scales = parameters["log_scales"].double().exp()
    wide = (scales**2 + filter_3d.double()[:, None] ** 2).sqrt()
    assert np.allclose([np.exp(rows[f"scale_{k}"].astype(np.float64)) for k in range(3)], wide.T, rtol=FLOAT32_SCALAR)
    opacity = torch.sigmoid(parameters["opacity_logits"].double()) * (scales / wide).prod(1)
    assert np.allclose(1 / (1 + np.exp(-rows["opacity"].astype(np.float64))), opacity, rtol=FLOAT32_SCALAR)


@pytest.mark.parametrize("rest", [0, 3, 8, 15])
def test_it_reads_back_and_renders_the_same_image(tmp_path, rest):
    gaussians = Gaussians(scene(3000, rest, rest=rest, size=-3.0), torch.rand(3000) * 0.05)
    write_splats(tmp_path / "a.ply", gaussians)
    again = read_splats(tmp_path / "a.ply")
    assert again.filter_3d is None and again.max_sh_degree == 3
    lower = lower_degree(again, gaussians.max_sh_degree)
    assert lower.parameters["sh_rest"].shape == (3000, rest, 3)
    before = picture(gaussians)
    for loaded in (again, lower):
        for name, a, b in zip(before._fields[:5], before, picture(loaded), strict=False):
            far = (a - b).abs() > FLOAT32_VALUE * a.abs().max()
            assert far.float().mean() <= DRAWN_OR_NOT, name
            assert (a - b).abs().mean() <= FLOAT32_VALUE * a.abs().max(), name


@given(st.integers(0, 2**31), st.floats(-30, 3), st.floats(0, 200), st.sampled_from([None, 0.0, 1e-20, 0.1]))
def test_extreme_gaussians_are_finite_and_render_the_same(tmp_path_factory, seed, size, spread, filter_3d):
    parameters = scene(20, seed, size=size)
    parameters["opacity_logits"] *= spread / 4
    gaussians = Gaussians(parameters, None if filter_3d is None else torch.full((20,), filter_3d))
    path = tmp_path_factory.mktemp("splats") / "a.ply"
    write_splats(path, gaussians)
    assert all(np.isfinite(independently(path)[name]).all() for name in FIELDS)
    difference = (picture(gaussians).color - picture(read_splats(path)).color).abs()
    # At an alpha of about 1/255 rounding decides whether a pixel is drawn.
    assert difference.max() < 2 * LEVEL_8BIT and difference.mean() < FLOAT32_VALUE


def written(kind: str, rest: int, extra: tuple[str, ...] = ()) -> tuple[bytes, dict[str, np.ndarray]]:
    """Three Gaussians as another program might write them: other order, other types, its own properties."""
    names = [
        "opacity",
        *extra,
        "rot_0",
        "rot_1",
        "rot_2",
        "rot_3",
        "x",
        "y",
        "z",
        "scale_2",
        "scale_1",
        "scale_0",
        *(f"f_rest_{k}" for k in range(rest)),
        "f_dc_0",
        "f_dc_1",
        "f_dc_2",
    ]
    order, letter = {
        "ascii": ("ascii", "="),
        "little": ("binary_little_endian", "<"),
        "big": ("binary_big_endian", ">"),
    }[kind]
    values = np.random.default_rng(rest).normal(size=(3, len(names))).round(4)
    types = ["double" if name in "xyz" else "float" for name in names]
    columns = list(zip(names, types, strict=True))
    table = np.empty(3, [(name, letter + ("f8" if t == "double" else "f4")) for name, t in columns])
    for k, name in enumerate(names):
        table[name] = values[:, k]
    head = (
        f"ply\nformat {order} 1.0\ncomment by somebody\nelement vertex 3\n"
        + "".join(f"property {t} {name}\n" for name, t in columns)
        + "end_header\n"
    )
    text = "".join(" ".join(str(x) for x in row) + "\n" for row in values)
    rows = text.encode() if kind == "ascii" else table.tobytes()
    return head.encode() + rows, {name: values[:, k].astype(np.float32) for k, name in enumerate(names)}


@pytest.mark.parametrize("kind", ["ascii", "little", "big"])
@pytest.mark.parametrize("rest", [0, 9, 24, 45])
def test_files_of_other_programs(tmp_path, kind, rest):
    content, values = written(kind, rest, ("segment", "filter_3D"))
    (tmp_path / "a.ply").write_bytes(content)
    gaussians = read_splats(tmp_path / "a.ply")
    found = gaussians.parameters
    assert np.array_equal(found["means"].detach(), np.stack([values[axis] for axis in "xyz"], 1))
    assert np.array_equal(found["log_scales"].detach(), np.stack([values[f"scale_{k}"] for k in range(3)], 1))
    assert np.array_equal(found["quaternions"].detach(), np.stack([values[f"rot_{k}"] for k in range(4)], 1))
    assert np.array_equal(found["opacity_logits"].detach(), values["opacity"])
    assert np.array_equal(gaussians.filter_3d, values["filter_3D"])
    assert found["sh_rest"].shape == (3, rest // 3, 3)
    for channel in range(3):
        for k in range(rest // 3):
            assert np.array_equal(found["sh_rest"][:, k, channel].detach(), values[f"f_rest_{rest // 3 * channel + k}"])


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda data: b"", "no PLY header"),
        (lambda data: data[:-1], "bytes of vertices"),
        (lambda data: data.replace(b"scale_2", b"scale_x"), "no scale_2"),
        (lambda data: data.replace(b"f_rest_8", b"fxrest_8"), "8 properties f_rest"),
        (lambda data: data.replace(b"f_rest_8", b"f_rest_9"), "9 properties f_rest"),
        (lambda data: data[:-4] + np.float32(np.nan).tobytes(), "NaN or infinity in f_dc_0"),
    ],
)
def test_damage_is_named_in_one_line(tmp_path, change, found):
    content, _ = written("little", 9)
    (tmp_path / "a.ply").write_bytes(change(content))
    with pytest.raises(InputError, match=found) as caught:
        read_splats(tmp_path / "a.ply")
    assert "a.ply" in str(caught.value) and "\n" not in str(caught.value)


def test_no_gaussians(tmp_path):
    write_splats(tmp_path / "a.ply", Gaussians(scene(0, 0)))
    assert len(independently(tmp_path / "a.ply")) == 0 and len(read_splats(tmp_path / "a.ply")) == 0


def test_opacities_of_zero_and_one_are_numbers_in_the_file(tmp_path):
    """With the 3D filter opacities are computed, and the logits of 0 and 1 are infinite."""
    parameters = scene(3, 1, rest=0)
    parameters["opacity_logits"] = torch.tensor([-200.0, 200.0, 0.5])
    for filter_3d in (None, torch.zeros(3)):
        write_splats(tmp_path / "a.ply", Gaussians(parameters, filter_3d))
        found = independently(tmp_path / "a.ply")["opacity"]
        assert found.tolist() == pytest.approx([-30.0, 30.0, 0.5], rel=FLOAT32_SCALAR)


OFFSET = (448260.0, 5411932.0, 136.0)


def test_positions_far_from_the_origin_are_doubles(tmp_path):
    gaussians = Gaussians(scene(500, 3, rest=8))
    write_splats(tmp_path / "near.ply", gaussians)
    write_splats(tmp_path / "far.ply", gaussians, OFFSET)
    head, body = (tmp_path / "far.ply").read_bytes().split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    assert "comment offset 448260.0 5411932.0 136.0" in lines
    assert [line for line in lines if "double" in line][-3:] == [f"property double {axis}" for axis in "xyz"]
    row = np.dtype([(name, "<f8" if name in "xyz" else "<f4") for name in FIELDS])
    rows = np.frombuffer(body, row)
    means = gaussians.parameters["means"].detach().numpy().astype(np.float64)
    assert np.array_equal(np.stack([rows[axis] for axis in "xyz"], 1), means + np.array(OFFSET))
    near = independently(tmp_path / "near.ply")
    assert all(np.array_equal(rows[name], near[name]) for name in FIELDS[3:])
    assert read_offset(tmp_path / "far.ply") == OFFSET and read_offset(tmp_path / "near.ply") == (0, 0, 0)
    # Read back in the local frame; from a file without the comment, by the offset that is given.
    plain = head.replace(b"comment offset", b"comment shifted") + b"end_header\n" + body
    (tmp_path / "plain.ply").write_bytes(plain)
    for again in (read_splats(tmp_path / "far.ply"), read_splats(tmp_path / "plain.ply", OFFSET)):
        assert np.allclose(again.parameters["means"].detach(), means, rtol=0, atol=FAR_POSITION)


@pytest.mark.parametrize("numbers", ["1 2", "1 2 3 4", "a b c", "nan 0 0", "1e999 0 0"])
def test_a_damaged_offset_is_named(tmp_path, numbers):
    write_splats(tmp_path / "a.ply", Gaussians(scene(5, 3)), OFFSET)
    content = (tmp_path / "a.ply").read_bytes()
    said = b"offset 448260.0 5411932.0 136.0"
    assert said in content
    (tmp_path / "a.ply").write_bytes(content.replace(said, f"offset {numbers}".encode()))
    with pytest.raises(InputError, match="offset"):
        read_splats(tmp_path / "a.ply")
