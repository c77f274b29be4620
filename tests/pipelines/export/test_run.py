"""Files that are exported, opened by programs of others and held against the solution itself."""

import json
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import fastkml
import geojson
import gpxpy
import numpy as np
import pandas
import polars
import pyarrow
import pyarrow.parquet
import pytest
import shapely
from evo.tools import file_interface
from lxml import etree
from rosbags.rosbag2 import Reader

import sinstool
from sinstool.core.earth import local_position_n
from sinstool.core.errors import ConfigurationError, SinstoolError
from sinstool.core.rotation import conjugate, log, multiply, to_euler
from sinstool.pipelines.export.run import export
from tests.pipelines.export.settings import configured

MODES = ("ins-gnss", "ins", "attitude")
MOVING = ("ins-gnss", "ins")
EVERY = (*MODES, "frd", "enu of frd", "pose only", "euler only")
DEGREE = np.pi / 180.0
NUMBER = r"-?\d+(?:\.\d+)?"


def apart(q, p):
    """Angles between attitudes, rad."""
    return np.linalg.norm(log(multiply(conjugate(q), p)), axis=1)


def local(result):
    origin = result.summary.output.origin
    place = (origin.latitude_deg * DEGREE, origin.longitude_deg * DEGREE, origin.height_m)
    return local_position_n(place, result.solution.position)


@pytest.mark.parametrize("mode", EVERY)
def test_a_result_is_read_back_as_the_solution_that_it_was_written_from(made, mode, tmp_path):
    path, result = made[mode]
    exported = export(path, tmp_path / "x.parquet", configured())
    table = pyarrow.parquet.read_table(exported.output.path)
    solution = result.solution
    assert table["time_ns"].to_pylist() == solution.time_ns.tolist()
    q = np.column_stack([table[f"q_nb_{part}"] for part in "wxyz"])
    assert apart(q, solution.q_nb).max() < 1e-9
    if mode == "euler only":
        return
    if solution.position is not None:
        place = np.column_stack([table[n] for n in ("latitude_deg", "longitude_deg", "height_m")])
        expected = solution.position / [DEGREE, DEGREE, 1.0]
        assert np.abs(place - expected).max() < 1e-9
        ned = np.column_stack([table[f"position_{a}_m"] for a in ("north", "east", "down")])
        assert np.abs(ned - local(result)).max() < 1e-6
    if mode == "pose only":
        return
    rates = np.column_stack([table[f"omega_ib_b_{axis}_rad_s"] for axis in "xyz"])
    assert np.abs(rates - solution.omega_ib_b).max() < 1e-15
    for field, stem, unit, factor in (
        ("covariance_attitude_n", "attitude", "deg", 1.0 / DEGREE),
        ("covariance_position_n", "position", "m", 1.0),
        ("covariance_velocity_n", "velocity", "m_s", 1.0),
    ):
        covariance = getattr(solution, field)
        names = [f"sigma_{stem}_{axis}_{unit}" for axis in ("north", "east", "down")]
        assert (names[0] in table.column_names) == (covariance is not None)
        if covariance is not None:
            sigma = factor * np.sqrt(np.einsum("nii->ni", covariance))
            written = np.column_stack([table[name] for name in names])
            known = covariance.any(axis=(1, 2))
            assert np.abs(written[known] / sigma[known] - 1.0).max() < 1e-6
            assert np.isnan(written[~known].astype(float)).all()
    if solution.velocity_n is not None:
        velocity = np.column_stack(
            [table[f"velocity_{axis}_m_s"] for axis in ("north", "east", "down")]
        )
        assert np.abs(velocity - solution.velocity_n).max() < 1e-9


@pytest.mark.parametrize("mode", MODES)
def test_csv_opens_in_pandas_and_polars(made, mode, tmp_path):
    path, result = made[mode]
    exported = export(path, tmp_path / "x.csv", configured())
    frame = pandas.read_csv(exported.output.path)
    solution = result.solution
    assert frame.time_ns.dtype == np.int64 and (frame.time_ns == solution.time_ns).all()
    assert tuple(frame.columns) == exported.output.columns
    seconds = (solution.time_ns - solution.time_ns[0]) / 1e9
    assert np.abs(frame.time_s - seconds).max() < 1e-9
    expected = solution.to_pandas()
    for name in expected.columns.intersection(frame.columns):
        rounding = 1e-9 if "m_s" in name else 1e-6 if name.endswith("_m") else 1e-8
        assert np.abs(frame[name] - expected[name]).max() < rounding, name
    assert set(expected.columns) - set(frame.columns) == {"log_time_ns"}
    other = polars.read_csv(exported.output.path)
    assert other.columns == list(frame.columns)
    assert other["time_ns"].to_list() == solution.time_ns.tolist()
    for name in other.columns[1:]:
        assert other[name].dtype == polars.Float64
        assert np.array_equal(other[name].to_numpy(), frame[name].to_numpy(), equal_nan=True)


def test_the_attitude_of_the_vehicle_is_that_of_the_sensor_less_its_mount(tmp_path):
    log, path = tmp_path / "drive.mcap", tmp_path / "result.mcap"
    sinstool.simulate("drive", log, duration=120.0, rate=50.0, grade="mems")
    result = sinstool.process(log, path, mode="ins-gnss")
    export(path, tmp_path / "file.csv", configured())
    result.export(tmp_path / "memory.csv")
    q_vb = result.solution.q_vb
    expected = to_euler(multiply(result.solution.q_nb, conjugate(q_vb))) / DEGREE
    for name in ("file", "memory"):
        frame = pandas.read_csv(tmp_path / f"{name}.csv")
        angles = frame[[f"vehicle_{angle}_deg" for angle in ("roll", "pitch", "heading")]]
        apart = (angles.to_numpy() - expected + 180.0) % 360.0 - 180.0
        assert np.abs(apart).max() < 1e-8
        assert frame.vehicle_heading_deg.between(0.0, 360.0).all()


def test_csv_and_parquet_hold_the_same(made, tmp_path):
    path, _ = made["ins-gnss"]
    for suffix in ("csv", "parquet"):
        export(path, tmp_path / f"x.{suffix}", configured())
    csv = pandas.read_csv(tmp_path / "x.csv")
    parquet = pandas.read_parquet(tmp_path / "x.parquet")
    assert list(csv.columns) == list(parquet.columns)
    assert np.allclose(csv, parquet, rtol=0.0, atol=1e-6, equal_nan=True)
    metadata = pyarrow.parquet.read_schema(tmp_path / "x.parquet").metadata
    assert metadata[b"sinstool.reference_frame"] == b"map"


@pytest.mark.parametrize("mode", [*MODES, "frd", "enu of frd"])
def test_tum_opens_in_evo(made, mode, tmp_path):
    path, result = made[mode]
    export(path, tmp_path / "x.tum", configured())
    trajectory = file_interface.read_tum_trajectory_file(str(tmp_path / "x.tum"))
    solution = result.solution
    assert trajectory.check()[0]
    assert np.abs(trajectory.timestamps - solution.time_ns / 1e9).max() < 1e-6
    # Body axes Forward-Left-Up in East-North-Up, by matrices written down here
    flip = np.diag([1.0, -1.0, -1.0])
    enu = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    for row in range(0, len(solution), 501):
        w, *v = solution.q_nb[row]
        x = np.array(v)
        cross = np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])
        c_nb = np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross
        turned = enu @ c_nb @ flip
        assert np.abs(trajectory.poses_se3[row][:3, :3] - turned).max() < 1e-9
    if solution.position is None:
        assert not trajectory.positions_xyz.any()
        assert "no position" in (tmp_path / "x.tum").read_text()[:400]
    else:
        assert np.abs(trajectory.positions_xyz - local(result) @ enu.T).max() < 1e-5


@pytest.mark.parametrize("mode", MOVING)
def test_tum_is_what_evo_reads_of_the_result_itself(made, mode, tmp_path):
    path, _ = made[mode]
    export(path, tmp_path / "x.tum", configured())
    ours = file_interface.read_tum_trajectory_file(str(tmp_path / "x.tum"))
    with Reader(path) as reader:
        theirs = file_interface.read_bag_trajectory(reader, "/sinstool/odometry")
    assert np.abs(ours.timestamps - theirs.timestamps).max() < 1e-6
    assert np.abs(ours.positions_xyz - theirs.positions_xyz).max() < 1e-5
    dots = np.abs((ours.orientations_quat_wxyz * theirs.orientations_quat_wxyz).sum(axis=1))
    assert np.abs(dots - 1.0).max() < 1e-9


KML = Path(fastkml.__file__).parent / "schema"
GX = "{http://www.google.com/kml/ext/2.2}"


def positions(result, rate):
    """Longitude, latitude (deg) and height (m) at whole periods."""
    every = round(50.0 / rate)
    place = result.solution.position[::every] / [DEGREE, DEGREE, 1.0]
    return place[:, [1, 0, 2]], result.solution.time_ns[::every]


@pytest.mark.parametrize("mode", MOVING)
def test_kml_holds_to_its_schema_and_opens_in_fastkml(made, mode, tmp_path):
    path, result = made[mode]
    export(path, tmp_path / "x.kml", configured(geoid_height=47.5))
    schema = etree.XMLSchema(etree.parse(KML / "kml22gx.xsd"))
    document = etree.parse(tmp_path / "x.kml")
    assert schema.validate(document), schema.error_log
    (track,) = document.iter(f"{GX}Track")
    coordinates = np.array([[*map(float, one.text.split())] for one in track.iter(f"{GX}coord")])
    when = track.iter("{http://www.opengis.net/kml/2.2}when")
    times = [one.text.removesuffix("Z") for one in when]
    expected, time_ns = positions(result, 10.0)
    assert np.abs(coordinates - expected + [0.0, 0.0, 47.5]).max(axis=0) == pytest.approx(
        [0, 0, 0], abs=1e-3
    )
    assert np.array(times, "datetime64[ns]").astype(int) == pytest.approx(time_ns, abs=1000)
    read = fastkml.KML.parse(tmp_path / "x.kml")
    (placemark,) = read.features[0].features
    assert len(placemark.kml_geometry.track_items) == len(expected)
    assert b"<altitudeMode>absolute" in (tmp_path / "x.kml").read_bytes()


def test_kml_without_the_geoid_lies_on_the_ground(made, tmp_path):
    export(made["ins"][0], tmp_path / "x.kml", configured())
    assert b"<altitudeMode>clampToGround" in (tmp_path / "x.kml").read_bytes()


# The elements of GPX 1.1 that may stand here, in their order
GPX = """<grammar xmlns="http://relaxng.org/ns/structure/1.0" ns="http://www.topografix.com/GPX/1/1"
  datatypeLibrary="http://www.w3.org/2001/XMLSchema-datatypes"><start><element name="gpx">
  <attribute name="version" ns=""><value>1.1</value></attribute>
  <attribute name="creator" ns=""><text/></attribute>
  <element name="trk"><element name="name"><text/></element><element name="trkseg"><oneOrMore>
  <element name="trkpt">
  <attribute name="lat" ns=""><data type="decimal"><param name="minInclusive">-90</param>
    <param name="maxInclusive">90</param></data></attribute>
  <attribute name="lon" ns=""><data type="decimal"><param name="minInclusive">-180</param>
    <param name="maxExclusive">180</param></data></attribute>
  <element name="ele"><data type="decimal"/></element>
  <element name="time"><data type="dateTime"/></element>
  <optional><element name="geoidheight"><data type="decimal"/></element></optional>
  </element></oneOrMore></element></element></element></start></grammar>"""


@pytest.mark.parametrize("geoid", [None, -21.25])
def test_gpx_holds_to_its_schema_and_opens_in_gpxpy(made, geoid, tmp_path):
    path, result = made["ins-gnss"]
    options = {} if geoid is None else {"geoid_height": geoid}
    export(path, tmp_path / "x.gpx", configured(rate=2.0, **options))
    schema = etree.RelaxNG(etree.fromstring(GPX))
    assert schema.validate(etree.parse(tmp_path / "x.gpx")), schema.error_log
    (track,) = gpxpy.parse((tmp_path / "x.gpx").read_text()).tracks
    (segment,) = track.segments
    expected, time_ns = positions(result, 2.0)
    read = [(p.longitude, p.latitude, p.elevation) for p in segment.points]
    heights = [0.0, 0.0, geoid or 0.0]
    assert np.abs(np.array(read) + heights - expected).max(axis=0) == pytest.approx(
        [0.0, 0.0, 0.0], abs=6e-4
    )
    times = [p.time.timestamp() for p in segment.points]
    assert times == pytest.approx((time_ns / 1e9).tolist(), abs=1e-3)


@pytest.mark.parametrize("mode", MOVING)
def test_geojson_opens_in_geojson_and_shapely(made, mode, tmp_path):
    path, result = made[mode]
    export(path, tmp_path / "x.geojson", configured(rate=5.0))
    text = (tmp_path / "x.geojson").read_text()
    (feature,) = geojson.loads(text).features
    assert feature.is_valid, feature.errors()
    expected, time_ns = positions(result, 5.0)
    line = shapely.from_geojson(json.dumps(feature.geometry))
    assert line.geom_type == "LineString" and line.has_z
    coordinates = shapely.get_coordinates(line, include_z=True)
    assert np.abs(coordinates - expected).max(axis=0) == pytest.approx([0, 0, 0], abs=6e-4)
    times = np.array(
        [one.rstrip("Z") for one in feature.properties["coordTimes"]], "datetime64[ns]"
    )
    assert times.astype(int) == pytest.approx(time_ns, abs=1000)


def test_geojson_is_cut_at_the_date_line(made, tmp_path):
    _, result = made["ins-gnss"]
    solution = result.solution
    place = solution.position.copy()
    place[:, 1] += np.pi - place[len(place) // 2, 1]
    moved = type(solution)(**{**vars(solution), "position": place})
    type(result)(moved, result.summary).export(tmp_path / "x.geojson")
    (feature,) = geojson.loads((tmp_path / "x.geojson").read_text()).features
    assert feature.is_valid, feature.errors()
    pieces = feature.geometry["coordinates"]
    assert feature.geometry["type"] == "MultiLineString" and len(pieces) > 1
    assert [len(p) for p in pieces] == [len(t) for t in feature.properties["coordTimes"]]
    for piece in pieces:
        longitudes = np.array(piece)[:, 0]
        assert np.ptp(longitudes) < 1.0 and np.abs(longitudes).max() <= 180.0


def test_names_in_maps_are_escaped(made, tmp_path):
    path = tmp_path / "a<b>&c.mcap"
    path.write_bytes(made["ins"][0].read_bytes())
    for suffix in ("kml", "gpx"):
        export(path, tmp_path / f"x.{suffix}", configured())
        names = [one.text for one in ET.parse(tmp_path / f"x.{suffix}").iter() if "name" in one.tag]
        assert set(names) == {"a<b>&c.mcap"}


@pytest.mark.parametrize(("rate", "every"), [(50.0, 1), (25.0, 2), (10.0, 5), (1.0, 50)])
def test_rows_are_thinned_evenly(made, rate, every, tmp_path):
    path, result = made["attitude"]
    exported = export(path, tmp_path / "x.csv", configured(rate=rate))
    times = pandas.read_csv(tmp_path / "x.csv").time_ns
    assert times.tolist() == result.solution.time_ns[::every].tolist()
    assert exported.input.rows == len(result.solution) and exported.output.rows == len(times)


def test_a_rate_above_that_of_the_result_takes_every_row(made, tmp_path):
    path, result = made["attitude"]
    assert export(path, tmp_path / "x.csv", configured(rate=1000.0)).output.rows == len(
        result.solution
    )


def test_start_and_end_cut_and_seconds_go_on_counting_from_the_first_row(made, tmp_path):
    path, result = made["attitude"]
    first = int(result.solution.time_ns[0])
    export(path, tmp_path / "a.csv", configured(start="10.5", end="20"))
    frame = pandas.read_csv(tmp_path / "a.csv")
    assert frame.time_s.iloc[0] == 10.5 and frame.time_s.iloc[-1] == 20.0
    later = str(first + 10_500_000_000), str(first + 20_000_000_000)
    export(path, tmp_path / "b.csv", configured(start=later[0], end=later[1]))
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_nothing_between_start_and_end(made, tmp_path):
    with pytest.raises(SinstoolError, match=r"no row between --start and --end.* 60.000 s"):
        export(made["attitude"][0], tmp_path / "x.csv", configured(start="100"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["kml", "gpx", "geojson"])
def test_maps_need_positions(made, kind, tmp_path):
    path, result = made["attitude"]
    for attempt in (
        lambda: export(path, tmp_path / f"x.{kind}", configured()),
        lambda: result.export(tmp_path / f"x.{kind}"),
    ):
        with pytest.raises(SinstoolError, match=r"has no position.*--mode ins"):
            attempt()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["x.xlsx", "x", "x.jsn"])
def test_other_suffixes_are_refused(made, name, tmp_path):
    with pytest.raises(ConfigurationError, match=r"\.csv, \.parquet|did you mean"):
        export(made["attitude"][0], tmp_path / name, configured())


def test_a_log_that_is_no_result_is_refused(drive, tmp_path):
    with pytest.raises(SinstoolError, match=r"not a result of sinstool.*sinstool process"):
        export(drive, tmp_path / "x.csv", configured())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["csv", "tum", "kml", "gpx", "geojson"])
def test_a_solution_in_memory_is_exported_as_its_file_is(made, kind, tmp_path):
    path, result = made["ins-gnss"]
    export(path, tmp_path / f"file.{kind}", configured())
    result.export(tmp_path / f"memory.{kind}")
    texts = [(tmp_path / f"{name}.{kind}").read_text() for name in ("file", "memory")]
    words = [re.sub(path.name if k == 0 else "drive.mcap", "NAME", t) for k, t in enumerate(texts)]
    numbers = [np.array([*map(float, re.findall(NUMBER, one))]) for one in words]
    assert re.sub(NUMBER, "", words[0]) == re.sub(NUMBER, "", words[1])
    # Rounding on the way through the messages shows in the last digit at most.
    assert len(numbers[0]) > 2000 and np.allclose(*numbers, rtol=1e-7, atol=2e-6)


def test_attitude_with_poses_opens_in_evo_itself(drive, made, tmp_path):
    emit = ("imu", "attitude", "pose")
    sinstool.process(drive, tmp_path / "pose.mcap", mode="attitude", emit=emit)
    export(tmp_path / "pose.mcap", tmp_path / "x.tum", configured())
    with Reader(tmp_path / "pose.mcap") as reader:
        theirs = file_interface.read_bag_trajectory(reader, "/sinstool/pose")
    ours = file_interface.read_tum_trajectory_file(str(tmp_path / "x.tum"))
    assert ours.num_poses == theirs.num_poses == len(made["attitude"][1].solution)
    dots = np.abs((ours.orientations_quat_wxyz * theirs.orientations_quat_wxyz).sum(axis=1))
    assert np.abs(dots - 1.0).max() < 1e-9 and not theirs.positions_xyz.any()


def test_without_pyarrow_the_extra_is_named(made, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'sinstool\[tables\]'"):
        export(made["attitude"][0], tmp_path / "x.parquet", configured())
    assert not list(tmp_path.iterdir())
    export(made["attitude"][0], tmp_path / "x.csv", configured())


def test_a_file_that_exists_stays_unless_it_may_be_replaced(made, tmp_path):
    path, _ = made["attitude"]
    (tmp_path / "x.csv").write_text("mine")
    with pytest.raises(SinstoolError, match="exists already"):
        export(path, tmp_path / "x.csv", configured())
    assert (tmp_path / "x.csv").read_text() == "mine"
    export(path, tmp_path / "x.csv", configured(overwrite=True))
    assert (tmp_path / "x.csv").read_text().startswith("time_ns,")


def test_the_api_names_the_frame_and_the_rows(made, tmp_path):
    _, result = made["ins-gnss"]
    exported = result.export(tmp_path / "x.csv", rate=1)
    assert exported.input.frame == "map" and exported.output.rows == 61
    with pytest.raises(ConfigurationError, match="export has no option rat"):
        result.export(tmp_path / "y.csv", rat=1)
    assert sinstool.Result.export.__doc__
