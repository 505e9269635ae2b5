"""Fence files: TOML and GeoJSON; errors name file, field and bound."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given

from ltv_mpc import Fence
from ltv_mpc.config import to_toml
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Disc, fence_for, ring_problem
from ltv_mpc.messages import Array
from ltv_mpc.references import Origin, Place, Point
from ltv_mpc.vehicle.parameters import Vehicle
from tests.ltv_mpc.geofence.shapes import rings

HARBOUR = """\
margin_m = 2.0

[origin]
latitude_deg = 60.39
longitude_deg = 5.32

[[keep_in]]
name = "basin"
vertices = [
  { north_m = -200.0, east_m = -200.0 }, { north_m = -200.0, east_m = 200.0 }, { north_m = 200.0, east_m = 200.0 },
  { north_m = 0.0, east_m = 0.0 }, { north_m = 200.0, east_m = -200.0 },
]

[[keep_out]]
margin_m = 5.0
vertices = [
  { latitude_deg = 60.3905, longitude_deg = 5.321 }, { latitude_deg = 60.3905, longitude_deg = 5.322 },
  { latitude_deg = 60.3909, longitude_deg = 5.3215 },
]

[[keep_out_disc]]
name = "buoy"
centre = { north_m = -50.0, east_m = 20.0 }
radius_m = 3.0
"""


def written(folder: Path, text: str, name: str = "fence.toml") -> str:
    path = folder / name
    path.write_text(text)
    return str(path)


def zone_table(fence: Fence) -> list[tuple[str, bool, float, float]]:
    return [(zone.label, zone.keep_in, zone.radius_m, zone.margin_m) for zone in fence.zones()]


def test_a_fence_comes_back_from_its_text(tmp_path: Path) -> None:
    fence = Fence.load(written(tmp_path, HARBOUR))
    assert Fence.load(written(tmp_path, to_toml(fence), "again.toml")) == fence
    assert zone_table(fence) == [
        ('keep_in[0] "basin"', True, 0.0, 2.0),
        ("keep_out[0]", False, 0.0, 5.0),
        ('keep_out_disc[0] "buoy"', False, 3.0, 2.0),
    ]


CROSSES = r'keep_in\[0\] "basin": the ring crosses itself: the edge from vertices\[2\] to vertices\[3\]'


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("margin_m = 2.0", "", 'key "margin_m" is missing'),
        ("latitude_deg = 60.3909", "latitude_deg = 95.0", r"keep_out\[0\].vertices\[2\].latitude_deg = 95.0"),
        ("radius_m = 3.0", "radius_m = 0.0", r"keep_out_disc\[0\].radius_m = 0.0: must be"),
        ("{ north_m = -50.0,", "{ depth_m = 3.0, north_m = -50.0,", "depth_m is not used"),
        ("latitude_deg = 60.3909", "latitude_deg = 61.0", r"keep_out\[0\]: vertices\[2\]: .*50 km from the origin"),
        ("[origin]\nlatitude_deg = 60.39\nlongitude_deg = 5.32\n", "", r"need an \[origin\]"),
        ("north_m = 0.0, east_m = 0.0 ", "north_m = 200.0, east_m = 200.0 ", r"vertices\[2\] and vertices\[3\] are"),
        ("= 0.0, east_m = 0.0 ", "= 0.0, east_m = -300.0 ", CROSSES),
        (HARBOUR, "margin_m = 1.0", r"no zone: give at least one of \[\[keep_in\]\]"),
    ],
)
def test_an_error_names_file_field_and_bound(tmp_path: Path, right: str, wrong: str, message: str) -> None:
    assert right in HARBOUR
    with pytest.raises(ConfigError, match=rf"fence\.toml.*{message}"):
        Fence.load(written(tmp_path, HARBOUR.replace(right, wrong)))


def test_whole_numbers_are_floats_to_the_kernels() -> None:
    """Compiled code exists for these alone: a first plan would wait half a minute for other code."""
    (zone,) = Fence(margin_m=1, keep_out_disc=(Disc(centre=Place(north_m=3, east_m=4), radius_m=2),)).zones()
    assert zone.vertices_m.dtype == np.float64
    assert (type(zone.radius_m), type(zone.margin_m)) == (float, float)


def square(east_deg: float = 0.0, north_deg: float = 0.0) -> list[list[float]]:
    """Return the closed ring of a square of 1 by 2 thousandths of a degree near 60.39, 5.32."""
    e, n = 5.32 + east_deg, 60.39 + north_deg
    return [[e, n], [e + 0.002, n], [e + 0.002, n + 0.001], [e, n + 0.001], [e, n]]


COORDINATES = {"Polygon": [square()], "MultiPolygon": [[square()]], "Point": [5.32, 60.39]}


def feature(zone: Any, geometry: str, coordinates: Any = None, **properties: object) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": {"zone": zone, **properties},
        "geometry": {"type": geometry, "coordinates": coordinates or COORDINATES[geometry]},
    }


def collection(*features: object, **members: object) -> str:
    origin = {"latitude_deg": 60.39, "longitude_deg": 5.32}
    content = {"type": "FeatureCollection", "margin_m": 2.0, "origin": origin, "features": features}
    return json.dumps(content | members)


def zones_of(zone: str, *rings: list[list[float]], **members: object) -> Fence:
    """Return the fence of one feature."""
    return Fence.from_geojson(collection(feature(zone, "MultiPolygon", [[ring] for ring in rings]), **members))


def test_geojson_of_programs_that_draw_maps_is_read() -> None:
    style: dict[str, object] = {"stroke": "#555555", "fill-opacity": 0.5, "name": None, "margin_m": None}
    text = collection(
        feature("keep_out_disc", "Point", radius_m=3.0, **{"marker-color": "#ff0000"}),
        feature("keep_in", "MultiPolygon", **style),
        feature("keep_in", "Polygon", name="basin"),
    )
    first, second, disc = Fence.from_geojson(text).zones()
    assert [first.label, second.label, disc.label] == ["keep_in[0]", 'keep_in[1] "basin"', "keep_out_disc[0]"]
    np.testing.assert_array_equal(first.vertices_m, second.vertices_m)
    assert (first.margin_m, disc.radius_m) == (2.0, 3.0)


SWAPPED = [[[60.39, 5.32], [60.39, 5.33], [60.4, 5.33], [60.39, 5.32]]]
FLAT = [[[5.32, 60.39], [5.33, 60.39], [5.32, 60.39], [5.32, 60.39]]]
FAR = [[square()], [square(north_deg=1e300)]]
SQUARES = [[square(0.004 * k)] for k in range(101)]
SYDNEY = [-33.8, 151.2]
OPEN = [[[5, 60], [5, 61], [6, 61], [6, 60]]]
MANY = [[[5.32 + 0.001 * math.cos(k % 501), 60.39 + 0.001 * math.sin(k % 501)] for k in range(502)]]


@pytest.mark.parametrize(
    ("third", "message"),
    [
        ({}, ": must be a Feature"),
        (feature("moat", "Point"), ".properties.zone = .moat.: must be one of keep_in, keep_out, keep_out_"),
        (feature([], "Polygon"), ".properties.zone"),
        (feature("keep_in", "Point"), ".geometry.type = .Point.: must be .Polygon. for keep_in"),
        (feature("keep_in", "Polygon", OPEN), ".geometry: is no geometry .*not form a closed"),
        (feature("keep_in", "Polygon", FLAT), ".vertices = .*: must be a list of at least 3 and at most 500"),
        (feature("keep_in", "Polygon", [4 * [[5.32, 60.39]]]), ".geometry.* at least 3 different positions"),
        (feature("keep_in", "MultiPolygon", FAR), ".geometry: must be longitude and latitude in degrees, at most 360"),
        (feature("keep_in", "Polygon", MANY), ".vertices.* at most 500"),
        (feature("keep_in", "Polygon", SWAPPED), r": vertices\[0\]: .* from the origin; positions are \[long"),
        (feature("keep_out_disc", "Point", SYDNEY, radius_m=3.0), ".centre.latitude_deg = 151.2: .*; positions are"),
    ],
)
def test_an_error_about_a_zone_of_geojson_names_the_feature(third: object, message: str) -> None:
    """The faulty feature is the third, and the second one that is to be kept in."""
    before = feature("keep_out_disc", "Point", radius_m=3.0), feature("keep_in", "Polygon", name="keep_in[7]")
    with pytest.raises(ConfigError, match=rf"features\[2\]{message}"):
        Fence.from_geojson(collection(*before, third))


def test_too_many_zones_are_refused_by_their_kind() -> None:
    with pytest.raises(ConfigError, match=r"keep_out = .*: must be a list of at most 100, each"):
        Fence.from_geojson(collection(feature("keep_out", "MultiPolygon", SQUARES)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not a JSON object"),
        ('{"type": "Feature"}', r"features\[0\]: must be a Feature with properties and a geometry"),
        (f'{{"type": "Polygon", "coordinates": {900 * "["}{900 * "]"}}}', r"features\[0\]: must be a Feature"),
        (collection(feature("keep_in", "Polygon", [[[5, 60], ["6", 60], [5, 61], [5, 60]]])), "must be number"),
        (
            collection(feature("keep_in", "Polygon"), origin={"latitude_deg": 95.0, "longitude_deg": 5.0}),
            r"\[origin\] latitude_deg = 95.0: must be .* 89$",
        ),
    ],
)
def test_an_error_of_geojson_names_the_file_and_the_member(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=rf"fence\.geojson.*{message}"):
        Fence.load(written(tmp_path, text, "fence.geojson"))


@pytest.mark.parametrize(
    ("name", "note"),
    [
        ("urn:ogc:def:crs:OGC:1.3:CRS84", ""),
        ("EPSG:4326", ""),
        ("urn:ogc:def:crs:EPSG::4258", "up to about 1 m"),
        ("EPSG:4269", "up to about 2 m"),
        ("urn:ogc:def:crs:EPSG::4230", None),  # ED50 is 102 m off
        ("EPSG:3857", None),
    ],
)
def test_a_datum_is_that_of_wgs_84_or_nearly_so_with_a_note_or_refused_by_its_name(name: str, note: str | None) -> None:
    crs, notes = {"type": "name", "properties": {"name": name}}, list[str]()
    of_feature = collection(feature("keep_in", "Polygon") | {"crs": crs})
    for text, where in (
        (collection(feature("keep_in", "Polygon"), crs=crs), "crs"),
        (of_feature, r"features\[0\].crs"),
    ):
        if note is None:
            with pytest.raises(ConfigError, match=rf"{where} = .{name}.: must be CRS84 or EPSG:4326"):
                Fence.from_geojson(text)
        else:
            Fence.from_geojson(text, "fence", notes)
    assert len(notes) == (2 if note else 0)
    assert all(note and note in said for said in notes)


@pytest.mark.parametrize("further", [[2.0], [2.0, 17.5], [2.0, 17.5, 3.0]])
def test_repeated_vertices_and_heights_and_measures_of_positions_are_read(further: list[float]) -> None:
    """RFC 7946: what further numbers mean is not defined, and parsers may ignore them."""
    ring, notes = [[*position, *further] for position in square()], list[str]()
    ring[-1][2] = 7.0
    ring.insert(2, ring[1])
    (zone,) = Fence.from_geojson(collection(feature("keep_in", "Polygon", [ring])), "f.geojson", notes).zones()
    (plain,) = zones_of("keep_in", square()).zones()
    np.testing.assert_array_equal(zone.vertices_m, plain.vertices_m)
    said = ["f.geojson: features[0]: numbers of its positions behind the third are not used"]
    assert notes == (said if len(further) > 1 else [])


def allowed(fence: Fence) -> Any:
    """Return where a fence of polygons lets the vehicle be, as a shapely geometry (m)."""
    zones = [(zone.keep_in, shapely.Polygon(zone.vertices_m)) for zone in fence.zones()]
    inside = shapely.intersection_all([polygon for keep_in, polygon in zones if keep_in])
    return inside - shapely.union_all([polygon for keep_in, polygon in zones if not keep_in])


def areas_of(*rings: list[list[float]]) -> list[Any]:
    return [shapely.Polygon(next(zones_of("keep_in", ring).zones()).vertices_m) for ring in rings]


def test_polygons_to_keep_out_of_are_zones_of_their_own() -> None:
    out = zones_of("keep_out", square(), square(0.004)).zones()
    assert [zone.label for zone in out] == ["keep_out[0]", "keep_out[1]"]
    with_hole = feature("keep_out", "Polygon", [square(), square(0.004)])
    with pytest.raises(ConfigError, match=r"features\[0\].geometry: must have no hole for keep_out"):
        Fence.from_geojson(collection(with_hole))


@pytest.mark.parametrize("last", [square(0.002), square(0.001, 0.0005), square(0.004), square(0.008, 0.003)])
def test_the_polygons_of_a_keep_in_zone_are_one_area_also_apart_and_around_another(last: list[list[float]]) -> None:
    """The third one is in the middle of the fourth, a frame of four."""
    frame = [square(east, north) for east, north in ((-0.004, -0.002), (-0.002, -0.002), (-0.004, 0.002))]
    for parts in ([square(), last], [square(), *frame, last]):
        fence, right = zones_of("keep_in", *parts), shapely.union_all(areas_of(*parts))
        assert len(fence.keep_in) == 1
        assert allowed(fence).symmetric_difference(right).area == pytest.approx(0.0, abs=1.0)


def across(middle_deg: float, *shapes: list[list[list[float]]]) -> Any:
    """Return where a keep-in zone lets the vehicle be, of polygons beside a meridian; longitudes end at 180 degrees."""
    coordinates = [[[[math.remainder(e + middle_deg, 360.0), n] for e, n in ring] for ring in of] for of in shapes]
    zone = feature("keep_in", "MultiPolygon", coordinates)
    return allowed(Fence.from_geojson(collection(zone, origin={"latitude_deg": 60.0, "longitude_deg": middle_deg})))


def test_an_area_across_the_antimeridian_is_that_across_another_meridian() -> None:
    """RFC 7946 cuts it there, other programs do not."""
    west, east, apart, whole, hole = (
        [[w, s], [e, s], [e, n], [w, n], [w, s]]
        for w, e, s, n in (
            (-0.002, 0.0, 60.0, 60.001),
            (0.0, 0.001, 60.0, 60.001),
            (0.003, 0.004, 60.0, 60.001),
            (-0.002, 0.002, 60.0, 60.001),
            (-0.001, 0.0005, 60.0002, 60.0005),
        )
    )
    for shapes in ([[west], [east]], [[west], [east], [apart]], [[whole, hole]], [[whole, hole], [apart]]):
        off = across(180.0, *shapes).symmetric_difference(across(5.0, *shapes))
        assert off.area == pytest.approx(0.0, abs=1.0)


def test_holes_of_a_keep_in_zone_are_keep_out_zones() -> None:
    around = [[5.31, 60.38], [5.34, 60.38], [5.34, 60.41], [5.31, 60.41], [5.31, 60.38]]
    holes = [square(), square(0.004)]
    fence = Fence.from_geojson(collection(feature("keep_in", "Polygon", [around, *holes], name="lake")))
    whole, *left_out = areas_of(around, *holes)
    assert allowed(fence).symmetric_difference(whole - shapely.union_all(left_out)).area < 1.0
    assert [zone.label for zone in fence.zones()] == ['keep_in[0] "lake"', 'keep_out[0] "lake"', 'keep_out[1] "lake"']


def at_origin(latitude_deg: float, longitude_deg: float = 5.32) -> Point:
    origin = Origin(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    return Point(north_m=0.0, east_m=0.0, origin=origin)


def test_a_fence_and_a_reference_must_have_the_same_origin(tmp_path: Path) -> None:
    """A metre of latitude is 9e-6 degrees; the same meridian on the far side of the Earth is far away, too."""
    vehicle, path = Vehicle.load("surface"), written(tmp_path, HARBOUR)
    assert fence_for(vehicle, Point(north_m=0.0, east_m=0.0), path) == fence_for(vehicle, at_origin(60.39 + 8e-6), path)
    for reference, metres in ((at_origin(60.39 + 1e-5), r"1\.1"), (at_origin(-60.39, -174.68), r"12,7\d\d,\d\d\d\.\d")):
        with pytest.raises(
            ConfigError, match=rf"fence {path}: \[origin\]: latitude 60.39.* is {metres} m away"
        ) as error:
            fence_for(vehicle, reference, path)
        assert reference.origin is not None
        assert f"{reference.origin.latitude_deg:.6f}, {reference.origin.longitude_deg:.6f}" in str(error.value)


@given(rings())
def test_a_star_is_a_simple_ring_and_two_swapped_vertices_of_five_are_not(ring: Array) -> None:
    assert ring_problem(ring) == ""
    bow = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    assert "crosses itself" in ring_problem(bow + ring[0])


def test_a_spike_and_a_vertex_on_another_edge_are_no_simple_rings() -> None:
    square = [[0.0, 0.0], [0.0, 4.0], [4.0, 4.0], [4.0, 0.0]]
    assert ring_problem(np.array(square)) == ""
    assert "meets" in ring_problem(np.array([*square, [2.0, 0.0], [2.0, 4.0]]))
    assert "meets" in ring_problem(np.array([[0.0, 0.0], [0.0, 4.0], [0.0, 2.0], [4.0, 0.0]]))
