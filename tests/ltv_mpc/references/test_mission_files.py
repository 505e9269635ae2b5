"""Paths in files of other programs: files made by other programs' libraries, and what is refused by item."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ltv_mpc import references
from ltv_mpc.errors import ConfigError
from ltv_mpc.references import Point, Waypoint, Waypoints
from ltv_mpc.references.geodesy import Origin

ORIGIN = Origin(latitude_deg=50.2, longitude_deg=-5.1)
PLACES = [(50.2, -5.1), (50.2003, -5.1001), (50.2004, -5.0995), (50.2001, -5.0994)]


def expected(speed_mps: float = 20.0, depths: tuple[float, ...] = ()) -> Waypoints:
    places = tuple(
        Waypoint(latitude_deg=at, longitude_deg=on, depth_m=z)
        for (at, on), z in zip(PLACES, depths or (None,) * 4, strict=True)
    )
    return Waypoints(waypoints=places, speed_mps=speed_mps, origin=ORIGIN)


def assert_same(read: references.Reference, right: Waypoints) -> None:
    assert isinstance(read, Waypoints)
    np.testing.assert_allclose(read.path().points, right.path().points, atol=1e-3)
    np.testing.assert_allclose(read.path().depth, right.path().depth, atol=1e-3)
    assert read.speed_mps == right.speed_mps


def test_a_mission_written_by_pymavlink_is_the_same_path(tmp_path: Path) -> None:
    mavwp = pytest.importorskip("pymavlink.mavwp")
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    loader = mavwp.MAVWPLoader()
    rows = [(0, 16, 0.0, *PLACES[0], 0.0), (3, 178, 0.0, 0.0, 0.0, 0.0)]
    rows += [(3, 16, 0.0, *place, -depth) for place, depth in zip(PLACES, (0.0, 2.0, 5.0, 1.0), strict=True)]
    for k, (frame, command, wait, latitude, longitude, height) in enumerate(rows):
        speed = 0.4 if command == 178 else 0.0
        item = mavlink.MAVLink_mission_item_message(
            1, 1, k, frame, command, 0, 1, wait, speed, 0.0, 0.0, latitude, longitude, height
        )
        loader.add(item)
    loader.save(str(tmp_path / "m.waypoints"))
    (tmp_path / "m.WAYPOINTS").write_text((tmp_path / "m.waypoints").read_text())
    for name in ("m.waypoints", "m.WAYPOINTS"):
        assert_same(references.load(str(tmp_path / name)), expected(0.4, (0.0, 2.0, 5.0, 1.0)))


def test_a_route_and_a_track_written_by_gpxpy_are_the_same_path(tmp_path: Path) -> None:
    gpxpy = pytest.importorskip("gpxpy")
    route, track = gpxpy.gpx.GPX(), gpxpy.gpx.GPX()
    route.routes.append(gpxpy.gpx.GPXRoute())
    route.routes[0].points = [gpxpy.gpx.GPXRoutePoint(at, on, elevation=7.0) for at, on in PLACES]
    track.tracks.append(gpxpy.gpx.GPXTrack())
    for part in (PLACES[:2], PLACES[2:]):
        segment = gpxpy.gpx.GPXTrackSegment([gpxpy.gpx.GPXTrackPoint(at, on) for at, on in part])
        track.tracks[0].segments.append(segment)
    route.waypoints.append(gpxpy.gpx.GPXWaypoint(*PLACES[0]))
    route.tracks.append(gpxpy.gpx.GPXTrack("Zürich"))
    notes: list[str] = []
    for gpx, encoding in ((route, "utf-8"), (track, "iso-8859-1"), (track, "utf-16")):
        (tmp_path / "m.gpx").write_text(gpx.to_xml().replace("UTF-8", encoding), encoding)
        assert_same(references.load(str(tmp_path / "m.gpx"), notes), expected())
    assert [note.rpartition(": ")[2] for note in notes] == [
        "not used are 1 empty routes and tracks, 1 waypoints beside it, 4 elevations"
    ]
    both = gpxpy.gpx.GPX()
    both.routes, both.tracks = route.routes, track.tracks
    (tmp_path / "m.gpx").write_text(both.to_xml())
    with pytest.raises(ConfigError, match="must have one route or track, it has 1 routes, 1 tracks, 0 waypoints"):
        references.load(str(tmp_path / "m.gpx"))


def feature(kind: str, coordinates: object, **properties: object) -> dict[str, object]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def test_a_line_and_a_point_of_geojson_stand_beside_the_zones_of_a_fence(tmp_path: Path) -> None:
    zone = feature("Polygon", [[[-5.2, 50.1], [-5.0, 50.1], [-5.0, 50.3], [-5.2, 50.1]]], zone="keep_in")
    line = feature("LineString", [[on, at, 3.0] for at, on in PLACES], speed_mps=0.3)
    path = tmp_path / "m.GEOJSON"
    for content in (line, {"type": "FeatureCollection", "features": [zone, line], "origin": None}):
        path.write_text(json.dumps(content))
        assert_same(references.load(str(path)), expected(0.3))
    path.write_text(json.dumps({"type": "Point", "coordinates": [-5.1, 50.2]}))
    assert references.load(str(path)) == Point(latitude_deg=50.2, longitude_deg=-5.1, origin=ORIGIN)
    path.write_text(json.dumps({"type": "LineString", "coordinates": [[-5.1, 50.2]] * 3}))
    notes: list[str] = []
    assert references.load(str(path), notes) == Point(latitude_deg=50.2, longitude_deg=-5.1, origin=ORIGIN)
    assert notes == [f"reference {path}: its 3 positions are one place, a point at which the vehicle stays"]
    lines = feature("MultiLineString", [[[on, at] for at, on in part] for part in (PLACES[:2], [], PLACES[1:])])
    without = {"type": "Feature", "properties": None, "geometry": None}
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [without, lines]}), "utf-16")
    assert_same(references.load(str(path), notes), expected())
    assert notes[1:] == [f"reference {path}: features[0]: has no geometry and is not used"]
    shapely = pytest.importorskip("shapely")
    path.write_text(shapely.to_geojson(shapely.LineString([(on, at) for at, on in PLACES])))
    assert_same(references.load(str(path)), expected())


def plan(*items: dict[str, object]) -> str:
    mission = {"cruiseSpeed": 1.5, "plannedHomePosition": [50.2, -5.1, 12.0], "items": items}
    return json.dumps({"fileType": "Plan", "mission": mission})


def simple(number: int, command: int, *parameters: float | None, frame: int = 3) -> dict[str, object]:
    return {"type": "SimpleItem", "doJumpId": number, "command": command, "frame": frame, "params": parameters}


def test_a_plan_of_qgroundcontrol_is_the_same_path(tmp_path: Path) -> None:
    items = [simple(k, 16, 0, 0, 0, None, *place, 50) for k, place in enumerate(PLACES, start=1)]
    (tmp_path / "m.plan").write_text(plan(*items))
    assert_same(references.load(str(tmp_path / "m.plan")), expected(1.5))
    (tmp_path / "m.plan").write_text(plan(simple(9, 178, 1, 0.7, -1, 0, 0, 0, 0, frame=2), *items))
    assert_same(references.load(str(tmp_path / "m.plan")), expected(0.7))


def mission(*rows: str) -> str:
    """Return a QGC WPL 110 file of frames, commands, parameters and places; home comes first."""
    items = (f"{k} 0 {row} 1" for k, row in enumerate(("0 16 0 0 0 0 50.2 -5.1 0", *rows)))
    return "\n".join(["QGC WPL 110", *items])


def test_speeds_waits_and_the_way_back_of_a_mission_are_those_of_its_waypoints(tmp_path: Path) -> None:
    rows = (
        "3 178 1 0.3 -1 0 0 0 0",
        "3 16 0 0 0 0 50.2002 -5.1 0",
        "3 19 20 0 0 0 50.2002 -5.0996 0",
        "3 82 0 0 0 0 50.2001 -5.0994 0",
        "3 178 1 1.2 -1 0 0 0 0",
        "3 16 0 0 0 0 50.2 -5.0996 0",
        "3 20 0 0 0 0 0 0 0",
    )
    (tmp_path / "m.waypoints").write_text(mission(*rows))
    read = references.load(str(tmp_path / "m.waypoints"))
    assert isinstance(read, Waypoints)
    assert read.speed_mps == 0.3
    at = [(50.2002, -5.1), (50.2002, -5.0996), (50.2001, -5.0994), (50.2, -5.0996), (50.2, -5.1)]
    assert [(place.latitude_deg, place.longitude_deg) for place in read.waypoints] == at
    assert [place.wait_s for place in read.waypoints] == [0.0, 20.0, 0.0, 0.0, 0.0]
    assert [place.speed_mps for place in read.waypoints] == [None, None, 1.2, None, None]


def test_what_a_file_holds_beside_its_path_is_a_note(tmp_path: Path) -> None:
    fence = {"polygons": [{"inclusion": True, "polygon": []}], "circles": [{}]}
    content = json.loads(plan(*(simple(k, 16, 0, 0, 0, None, *place, 50) for k, place in enumerate(PLACES[:2], 1))))
    (tmp_path / "m.plan").write_text(json.dumps(content | {"geoFence": fence, "rallyPoints": {"points": [[]]}}))
    text = mission("3 16 0 0 0 0 50.2002 -5.1 7", "3 16 0 0 0 0 50.2 -5.1002 0") + "\n# pymavlink writes comments"
    (tmp_path / "m.txt").write_text(text)
    without_home = text.replace("0 16 0 0 0 0 50.2 -5.1 0", "0 16 0 0 0 0 0 0 0")
    (tmp_path / "m.waypoints").write_text(without_home)
    features = [feature("Polygon", [], zone="keep_in"), feature("Point", [-5.1, 50.2])]
    features.append(feature("LineString", [[-5.1, 50.2, 3.0], [-5.1, 50.201]]))
    crs = {"type": "name", "properties": {"name": "EPSG:4258"}}
    (tmp_path / "m.json").write_text(json.dumps({"type": "FeatureCollection", "features": features, "crs": crs}))
    for name, says in (
        ("m.plan", "2 zones of its geofence, 1 rally points, 2 altitudes"),
        ("m.txt", "1 altitudes"),
        ("m.waypoints", "1 altitudes"),
        ("m.json", "1 zones of a fence, 1 points beside it, 2 heights"),
    ):
        notes: list[str] = []
        read = references.load(str(tmp_path / name), notes)
        assert isinstance(read, Waypoints)
        assert len(read.waypoints) == 2
        assert notes[-1].endswith(f"{name}: not used are {says}")
        assert len(notes) == 1 + (name == "m.json")


GOES, STAYS = "3 16 0 0 0 0 50.2 -5 0", "3 17 0 0 0 0 50.2 -5 0"
"""Waypoints elsewhere, without and with an end of the mission."""


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("m.waypoints", mission(STAYS, GOES), "item 2 MAV_CMD_NAV_WAYPOINT (16) follows an item without an end"),
        (
            "m.waypoints",
            mission(GOES, "3 178 1 0 -1 0 0 0 0", "3 21 0 0 0 0 0 0 0"),
            "item 2 MAV_CMD_DO_CHANGE_SPEED (178) speed 0 m/s must be above 0, and finite; "
            "item 3 MAV_CMD_NAV_LAND (21)",
        ),
        ("m.waypoints", mission("3 93 5 0 0 0 0 0 0"), "item 1 MAV_CMD_NAV_DELAY (93) has no place before it"),
        ("m.waypoints", "QGC WPL 120\n", "line 1 = "),
        ("m.waypoints", mission("3 16 0 0 0 0 50.2 -5"), "line 3 = "),
        ("m.waypoints", mission(GOES.replace("16", "16.7")), "line 3 = "),
        ("m.waypoints", mission("3 16 0 0 0 0 50.2 inf 0"), "item 1 MAV_CMD_NAV_WAYPOINT (16) latitude_deg = 50.2"),
        ("m.waypoints", mission(), "has no path and no point"),
        ("m.plan", "{", "is not a JSON object"),
        ("m.waypoints", mission() + f"\n0 0 {GOES} 1", "item 0: has its number 2 times"),
        ("m.plan", "{}", 'key "mission" is missing: must be a table with items, plannedHomePosition'),
        ("m.plan", '{"version": 99, "mission": {"items": []}}', "version = 99: must be 1"),
        ("m.plan", '{"fileType": "Mission", "mission": {"items": []}}', 'fileType = "Mission": must be "Plan"'),
        ("m.plan", '{"mission": {"version": 1, "items": []}}', "[mission] version = 1: must be 2"),
        ("m.plan", '{"mission": {"items": [], "items": []}}', 'key "items" occurs 2 times in one object'),
        ("m.plan", plan(simple(1, 16.7, *7 * [0])), "item 1: command = 16.7: must be an integer"),  # type: ignore[arg-type]
        ("m.plan", plan(simple(1, 16, 0)), "item 1: has 1 of 7 parameters"),
        ("m.plan", plan(simple(2, 16, *7 * [0]), simple(2, 16, *7 * [0])), "item 2: has its number 2 times"),
        ("m.plan", plan(simple(1, 16, "5", *6 * [0])), 'item 1: params[0] = "5": must be a number'),  # type: ignore[arg-type]
        ("m.plan", plan({"type": "ComplexItem", "complexItemType": "survey"}), "item 1: survey cannot be followed"),
        ("m.geojson", '{"type": "LineString", "coordinates": [[-5, 50], [-5, 52]]}', "latitude_deg = 52"),
        ("m.geojson", '{"type": "FeatureCollection", "features": []}', "they hold 0"),
        ("m.geojson", '{"type": "Point", "coordinates": [556000, 5.6e6]}', "must be longitude and latitude in degrees"),
        ("m.geojson", '{"type": "MultiPoint", "coordinates": []}', "features[0]: must be a LineString, a Point"),
        ("m.KML", "<kml/>", "is KML: convert it, as with ogr2ogr m.geojson m.KML"),
    ],
)
def test_what_a_path_cannot_do_is_refused_by_item_and_name(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError) as error:
        references.load(str(tmp_path / name))
    assert says in str(error.value)
    assert str(error.value).count("reference ") == 1
