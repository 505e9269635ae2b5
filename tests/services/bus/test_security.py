"""Certificates are whole and private, rights follow the topics table, and without asking nobody outside is reached."""

from __future__ import annotations

import ipaddress
import json
import os
import re
import shutil
import stat
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ltv_mpc.errors import ConfigError
from services.bus import certificates
from services.bus.options import BusOptions
from services.bus.roles import EDGES, HISTORY, ROLES, SEES_EVERYTHING, access_control, reads, writes
from services.bus.security import credentials
from services.bus.session import Session, configuration, open_session
from services.bus.topics import TOPICS
from services.cli.app import run
from tests.system.alone import CLI, started
from tests.waiting import until


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("certs") / "made"
    certificates.make(path, ROLES, hosts=("otter.local", "192.168.2.10"), days=30)
    return path


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


# --- certificates ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("role", ROLES)
def test_each_role_has_a_certificate_of_its_own_key_signed_by_the_authority(folder: Path, role: str) -> None:
    of_role, authority = certificate(folder / f"{role}.pem"), certificate(folder / "ca.pem")
    of_role.verify_directly_issued_by(authority)
    key = load_pem_private_key((folder / f"{role}.key").read_bytes(), password=None)
    assert key.public_key() == of_role.public_key()
    (name,) = of_role.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    assert name.value == role
    usage = of_role.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert set(usage) == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
    hosts = of_role.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert hosts.get_values_for_type(x509.DNSName) == ["localhost", "otter.local"]
    assert ipaddress.ip_address("192.168.2.10") in hosts.get_values_for_type(x509.IPAddress)
    assert ipaddress.ip_address("127.0.0.1") in hosts.get_values_for_type(x509.IPAddress)
    assert not of_role.extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def test_no_file_is_anybody_elses_to_read_and_the_authoritys_key_is_not_kept(folder: Path) -> None:
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(file.stat().st_mode) for file in folder.iterdir()} == {0o600}
    assert {file.name for file in folder.iterdir()} == {
        "ca.pem",
        *(f"{role}.{kind}" for role in ROLES for kind in ("pem", "key")),
    }


def test_a_missing_open_or_foreign_key_is_refused_by_name(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "certs"
    shutil.copytree(folder, copy)
    key, authority = copy / "plant.key", copy / "ca.pem"
    assert credentials(copy, "plant").key == key
    for damage, role, problem in (
        (lambda: key.chmod(0o640), "plant", r"plant\.key: others may read this key: chmod 600"),
        (lambda: shutil.copy(copy / "sensors.key", key), "plant", r"plant\.pem: does not match plant\.key"),
        (key.unlink, "plant", r"plant\.key: no such file; `ltv-mpc certs new"),
        (lambda: authority.write_text("nothing"), "sensors", r"ca\.pem: is not a PEM certificate"),
    ):
        damage()
        with pytest.raises(ConfigError, match=problem):
            credentials(copy, role)


def test_the_command_makes_them_once_and_again_only_by_force(tmp_path, capsys) -> None:
    out = tmp_path / "certs"
    assert run(["certs", "new", str(out), "--host", "otter.local", "--days", "10"]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    lifetime = certificate(out / "plant.pem").not_valid_after_utc - certificate(out / "plant.pem").not_valid_before_utc
    assert lifetime.days == 11
    before = (out / "plant.key").read_bytes()
    assert run(["certs", "new", str(out)]) == 2
    assert "is not empty" in capsys.readouterr().err
    assert (out / "plant.key").read_bytes() == before
    assert run(["certs", "new", str(out), "--force"]) == 0
    assert (out / "plant.key").read_bytes() != before


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("certs new DIR --host a/b", 'option --host: "a/b": must be a host'),
        ("certs new FILE", "is a file"),
        ("router --certs none", "option --certs none/ca.pem: no such file"),
        ("plant --certs CERTS --connect tcp/127.0.0.1:7447", "option --connect"),
        ("router --certs CERTS --listen unixsock-stream/x", "must be tls/HOST:PORT with --certs"),
        ("sim --certs CERTS --lockstep", "option --certs: cannot act together with --lockstep"),
        ("sim --certs CERTS --perfect-state", "option --certs: cannot act together with run.perfect_state"),
        ("sim --certs none", "option --certs none/ca.pem: no such file"),
    ],
)
def test_bad_options_are_refused_before_anything_starts(line, says, folder, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "FILE").write_text("")
    assert run(line.replace("CERTS", str(folder)).split()) == 2
    assert says in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["FILE"]


# --- rights ----------------------------------------------------------------------------------------------------------


def test_the_sole_writer_of_a_topic_is_the_only_role_that_may_put_on_it() -> None:
    for topic in TOPICS:
        if topic.written_by == "*":  # each speaks for itself alone
            own = {role: [key for key in writes(role) if key.startswith(f"{topic.key}/")] for role in ROLES}
            assert own == {role: [f"{topic.key}/{role}"] for role in ROLES}
            continue
        may = {role for role in ROLES if topic.key in writes(role)}
        armed_by_the_simulation = {"plant"} if topic.written_by == "operator" else set()
        edges = set(EDGES) if topic.key in ("estimate", "command", "obstacles", "applied") else set()
        assert may == {topic.written_by} | armed_by_the_simulation | edges, topic.key


def test_the_truth_is_for_the_sensors_and_those_who_watch() -> None:
    may = {role for role in ROLES if "world/truth" in reads(role) or reads(role) == ("**",)}
    assert may == {"sensors", *SEES_EVERYTHING}
    assert set(SEES_EVERYTHING) == {"supervisor", "recorder", "display", "operator"}
    assert set(reads("controller")) >= {"estimate/**", "applied", "clock"}
    assert "**" not in reads("controller")


def test_a_named_source_may_publish_on_its_own_key_alone_and_the_controller_reads_it() -> None:
    assert writes("estimator-gnss") == ("estimate/gnss",)
    assert not [role for role in ROLES if "estimate/gnss" in writes(role)]
    assert "**" not in reads("estimator-gnss")


def test_a_router_learns_the_named_sources_from_the_certificates_in_its_folder(tmp_path: Path) -> None:
    assert run(["certs", "new", str(tmp_path / "certs"), "--source", "gnss", "--source", "dvl-2"]) == 0
    (tmp_path / "certs" / "estimator-gnss.key").unlink()  # it needs no key
    control = configuration(BusOptions(listen=("tls/127.0.0.1:7447",), certs=tmp_path / "certs", role="router"))
    rules = {rule["id"]: rule["key_exprs"] for rule in json.loads(control.get_json("access_control/rules"))}
    assert rules["estimator-gnss puts"] == ["**/estimate/gnss"]
    assert rules["estimator-dvl-2 puts"] == ["**/estimate/dvl-2"]
    assert rules["estimator puts"].count("**/estimate") == 1


def test_a_router_denies_by_default_and_grants_within_its_namespace() -> None:
    control = access_control("auv/7")
    assert (control["enabled"], control["default_permission"]) == (True, "deny")
    granted = {
        (rule["id"].split()[0], message, flow, key)
        for rule in control["rules"]
        for message in rule["messages"]
        for flow in rule["flows"]
        for key in rule["key_exprs"]
    }

    def may(*what: str) -> set[str]:
        return {role for role, *right in granted if tuple(right) == what}

    assert may("put", "ingress", "auv/7/plan") == {"controller"}
    assert {"plant"} < may("declare_subscriber", "ingress", "auv/7/plan") == may("put", "egress", "auv/7/plan")
    assert all(key.startswith("auv/7/") for _, _, _, key in granted)
    assert {message for _, message, _, key in granted if key != "auv/7/history"} == {"put", "declare_subscriber"}
    assert may("reply", "ingress", "auv/7/history") == {"recorder"}
    assert may("query", "ingress", "auv/7/history") == {*SEES_EVERYTHING} - {"recorder"}
    everywhere = access_control("")
    assert ["**/plan" in rule["key_exprs"] for rule in everywhere["rules"]].count(True) == 3 + 2 * len(EDGES)
    assert [subject["cert_common_names"] for subject in control["subjects"]] == [[role] for role in ROLES[1:]]


def test_who_listens_with_certificates_denies_by_default_and_asks_for_one(folder: Path) -> None:
    config = configuration(BusOptions(listen=("tls/127.0.0.1:7447",), certs=folder, role="router"))
    assert json.loads(config.get_json("access_control/default_permission")) == "deny"
    tls = "transport/link/tls"
    for key in ("access_control/enabled", f"{tls}/enable_mtls", f"{tls}/verify_name_on_connect"):
        assert json.loads(config.get_json(key)) is True
    client = configuration(BusOptions(certs=folder, role="plant"))
    assert "tls/127.0.0.1:7447" in client.get_json("connect/endpoints")
    assert client.get_json("transport/link/tls/connect_private_key") == json.dumps(str(folder / "plant.key"))


@pytest.mark.parametrize(("role", "answered"), [("operator", True), ("controller", False)])
def test_who_may_read_everything_may_ask_for_the_history(folder, free_port, role, answered) -> None:
    endpoint = f"tls/127.0.0.1:{free_port}"

    def opened(as_role: str) -> Session:
        ends = {"listen" if as_role == "router" else "connect": (endpoint,)}
        return open_session(BusOptions(**ends, certs=folder, role=as_role), stop=lambda: False, say=print)

    with opened("router"), opened("recorder") as aboard, opened(role) as ashore:
        aboard.serve(HISTORY, lambda query, _, reply: reply(b"reply to " + query, None))
        if answered:  # once the declaration has taken its way to the router
            until(lambda: ashore.ask(HISTORY, b"first", timeout_s=1.0) == b"reply to first")
        else:
            assert ashore.ask(HISTORY, b"first", timeout_s=1.0) is None


# --- by default nobody outside is reached ----------------------------------------------------------------------------


@pytest.mark.parametrize("options", [BusOptions(), BusOptions(listen=("tcp/127.0.0.1:7447",)), BusOptions(mode="peer")])
def test_no_session_scouts_and_none_takes_in_a_message_without_bound(options, monkeypatch) -> None:
    monkeypatch.delenv("ZENOH_CONFIG", raising=False)
    config = configuration(options)
    for way in ("multicast", "gossip"):
        assert json.loads(config.get_json(f"scouting/{way}/enabled")) is False
    assert json.loads(config.get_json("transport/link/rx/max_message_size")) == 2 * 2**20
    assert re.search(r"0\.0\.0\.0|\[::\]", config.get_json("listen/endpoints")) is None


@pytest.mark.skipif(not Path("/proc/self/net/tcp").exists(), reason="sockets are read off /proc")
def test_a_router_that_is_told_nothing_has_no_socket_but_one_on_loopback(free_port: int) -> None:
    with started(*CLI, "router", "--listen", f"tcp/127.0.0.1:{free_port}") as (router, lines):
        lines.until(lambda line: "ready at" in line)
        assert sockets(router.pid) == {("tcp", "0100007F")}  # 127.0.0.1, as the kernel writes it


def sockets(pid: int) -> set[tuple[str, str]]:
    """Protocol and local address of every internet socket of a process."""
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        target = os.readlink(descriptor)
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = set()
    for protocol in ("tcp", "tcp6", "udp", "udp6", "raw"):
        table = Path(f"/proc/{pid}/net/{protocol}")
        rows = [line.split() for line in table.read_text().splitlines()[1:]] if table.exists() else []
        found |= {(protocol, row[1].partition(":")[0]) for row in rows if row[9] in inodes}
    return found
