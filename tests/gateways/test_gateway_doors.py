"""Who comes in by a gateway, and what its clients may do: other users of the machine, files and code by name."""

from __future__ import annotations

import json
import os
import socket
import xmlrpc.client
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from daemon_fixture import Runtime, running_daemon
from foxglove_app import FoxgloveApp
from other_user import as_nobody, needs_root
from rosbridge_client import RosbridgeClient
from running_gateway import running_gateway

from slidectl import web_access
from slidectl.errors import SlidectlError

CONTROLLER = """
from slidectl.control import Controller, EffortJointInterface


class Still(Controller):
    interface_type = EffortJointInterface

    def init(self, interface, node):
        pass

    def update(self, time_ns, period_s):
        pass
"""
KINDS = ("ros1", "websocket", "foxglove")
TOKEN = "a-word-for-tests"
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
TETRAHEDRON = "".join(f"v {corner}\n" for corner in ("0 0 0", "1 0 0", "0 1 0", "0 0 1")) + (
    "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
)


@pytest.fixture(scope="module")
def world() -> Iterator[Runtime]:
    with running_daemon(paused=True) as runtime, runtime.client() as client:
        client.spawn("slider", controllers="config/slider_control.yaml")
        yield runtime


def status_of(address: str, path: str = "/") -> tuple[int, str]:
    """Status and text of the answer to a WebSocket handshake, read from the socket as it comes."""
    url = urlsplit(address)
    with socket.create_connection((url.hostname, url.port), timeout=20) as connection:
        connection.sendall(
            f"GET {path} HTTP/1.1\r\nHost: localhost:{url.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        text = b""
        while b"\r\n\r\n" not in text and (piece := connection.recv(4096)):
            text += piece
        while b"HTTP/1.1 4" in text and (piece := connection.recv(4096)):
            text += piece
    return int(text.split()[1]), text.decode("utf-8", "replace")


def system_state(address: str) -> list[Any]:
    state: list[Any] = xmlrpc.client.ServerProxy(address).getSystemState("/test")  # type: ignore[assignment]
    return state


def refusal_of_ros(address: str) -> str:
    """What the master says to a call."""
    try:
        return str(system_state(address))
    except xmlrpc.client.ProtocolError as error:
        return f"{error.errcode}"


# --- another user ---------------------------------------------------------------------------------------------------


@needs_root
@pytest.mark.parametrize("kind", ["websocket", "foxglove"])
def test_another_user_of_the_machine_is_refused_without_a_token(world: Runtime, kind: str) -> None:
    with running_gateway(world, kind) as address:
        assert status_of(address)[0] == 101
        status, text = as_nobody(lambda: status_of(address))
        assert status == 403
        assert "the connection comes from user 65534" in text
        assert "--token" in text


@needs_root
@pytest.mark.parametrize("kind", ["websocket", "foxglove"])
def test_another_user_comes_in_with_the_token_and_where_all_users_may(world: Runtime, kind: str) -> None:
    with running_gateway(world, kind, token=TOKEN) as address:
        assert as_nobody(lambda: status_of(address))[0] == 401
        assert as_nobody(lambda: status_of(address, f"/?token={TOKEN}"))[0] == 101
    with running_gateway(world, kind, any_user=True) as address:
        assert as_nobody(lambda: status_of(address))[0] == 101


@needs_root
def test_the_ros_master_and_its_nodes_serve_their_own_user_alone(world: Runtime) -> None:
    with running_gateway(world, "ros1") as address:
        code, _, (_, _, services) = system_state(address)
        assert code == 1
        assert as_nobody(lambda: refusal_of_ros(address)) == "403"
        assert services
        master = xmlrpc.client.ServerProxy(address)
        node: list[Any] = master.lookupNode("/test", "/gazebo")  # type: ignore[assignment]
        assert as_nobody(lambda: refusal_of_ros(node[2])) == "403"
        service: list[Any] = master.lookupService("/test", "/gazebo/pause_physics")  # type: ignore[assignment]
        place = urlsplit(service[2])

        def first_bytes() -> bytes:
            with socket.create_connection((place.hostname, place.port), timeout=20) as connection:
                header = b"service=/gazebo/pause_physics", b"md5sum=*", b"callerid=/test", b"probe=1"
                body = b"".join(len(each).to_bytes(4, "little") + each for each in header)
                try:
                    connection.sendall(len(body).to_bytes(4, "little") + body)
                    return connection.recv(4096)
                except ConnectionError:
                    return b""

        assert b"std_srvs/Empty" in first_bytes()
        assert b"std_srvs/Empty" not in as_nobody(first_bytes)
    with running_gateway(world, "ros1", any_user=True) as address:
        assert as_nobody(lambda: system_state(address))[0] == 1


@needs_root
def test_the_user_of_a_connection_is_told_by_the_kernel() -> None:
    with socket.create_server(("::", 0), family=socket.AF_INET6, dualstack_ipv6=True) as listener:
        port = listener.getsockname()[1]
        for host in ("127.0.0.1", "::1", "::ffff:127.0.0.1"):
            for connect in (lambda host=host: connected(host, port), lambda host=host: closed(host, port)):
                as_nobody(connect)
            with socket.create_connection((host, port)) as own:
                found = [listener.accept() for _ in range(3)]
                told = [web_access.stranger(peer[:2], here.getsockname()[:2]) for here, peer in found]
                # nobody's connections are closed by now: the kernel has no process for them, and shows root
                assert ["cannot be determined" in text for text in told] == [True, True, False]
                here, peer = found[2]
                ends = [web_access._numbers(end[:2]) for end in (peer, here.getsockname())]
                assert web_access._by_netlink(*ends) == web_access._by_table(*ends) == os.geteuid()
                assert own.fileno() > 0
            for here, _ in found:
                here.close()


def connected(host: str, port: int) -> None:
    with socket.create_connection((host, port)):
        pass


def closed(host: str, port: int) -> None:
    connection = socket.create_connection((host, port))
    connection.sendall(b"x")
    connection.close()


# --- what clients may have done -------------------------------------------------------------------------------------


def refused_calls(folder: Path) -> dict[str, dict[str, Any]]:
    """Each call that names a file or code, with a request that would work for the owner."""
    (folder / "still.py").write_text(CONTROLLER)
    (folder / "box.urdf").write_text(f'<robot name="box"><link name="base">{INERTIAL}</link></robot>')
    return {
        "/slidectl/load_controller_file": {"robot": "slider", "name": "c", "file": str(folder / "still.py")},
        "/slidectl/reload_controller": {"robot": "slider", "name": "c"},
        "/slidectl/save": {"name": "s", "file": str(folder / "saved")},
        "/slidectl/load": {"file": str(folder / "kept")},
        "/slidectl/export_snapshot": {"name": "kept", "file": str(folder / "saved")},
        "/slidectl/sources": {"digest": "0" * 64, "note": "<?slidectl-source {}?>"},
    }


def test_a_client_of_a_gateway_names_neither_files_nor_code(world: Runtime, tmp_path: Path) -> None:
    with running_gateway(world, "websocket") as url, RosbridgeClient(url) as browser, world.client() as owner:
        owner.call("/slidectl/save", {"name": "kept", "file": str(tmp_path / "kept")})
        requests = refused_calls(tmp_path)
        before = sorted(tmp_path.iterdir())
        for service, request in requests.items():
            answer = browser.call(service, **request)
            assert not answer["result"], service
            assert "not permitted on this connection" in answer["values"], service
            assert "--allow" in answer["values"], service
        answer = browser.call("/slidectl/spawn_entity", entity_resource={"uri": f"file://{tmp_path}/box.urdf"})
        assert "not permitted" in answer["values"]["result"]["error_message"]
        assert sorted(tmp_path.iterdir()) == before
        assert owner.call("/slidectl/list_robots")["robots"][0]["controllers"] == []
        offered = set(browser.call("/rosapi/services")["values"]["services"])
        assert not offered & {"/slidectl/load_controller_file", "/slidectl/export_snapshot"}
        assert {"/slidectl/save", "/gazebo/spawn_urdf_model"} <= offered
        for service in ("/slidectl/save", "/slidectl/load"):  # what stays in the world is no file
            assert browser.call(service, name="kept")["result"], service


def test_what_is_allowed_at_the_start_is_permitted(world: Runtime, tmp_path: Path) -> None:
    requests = refused_calls(tmp_path)
    with running_gateway(world, "websocket", allow=["files"]) as url, RosbridgeClient(url) as browser:
        assert browser.call("/slidectl/save", **requests["/slidectl/save"])["result"]
        assert (tmp_path / "saved").exists()
        assert not browser.call("/slidectl/load_controller_file", **requests["/slidectl/load_controller_file"])[
            "result"
        ]
    with running_gateway(world, "websocket", allow=["code"]) as url, RosbridgeClient(url) as browser:
        answer = browser.call("/slidectl/load_controller_file", **requests["/slidectl/load_controller_file"])
        assert answer["values"]["ok"], answer
        assert not browser.call("/slidectl/save", **requests["/slidectl/save"])["result"]
    with world.client() as owner:
        owner.call("/slider/controller_manager/unload_controller", {"name": "c"})


def test_ros_and_foxglove_show_no_service_of_files_or_code(world: Runtime) -> None:
    hidden = {"/slidectl/load_controller_file", "/slidectl/reload_controller", "/slidectl/export_snapshot"}
    for allow, shown in (([], set()), (["files", "code"], hidden)):
        with running_gateway(world, "ros1", allow=allow) as address:
            services = {name for name, _ in system_state(address)[2][2]}
            assert services & hidden == shown
            assert "/gazebo/spawn_urdf_model" in services
        with running_gateway(world, "foxglove", allow=allow) as address, FoxgloveApp(address) as app:
            app.wait("advertiseServices")
            assert app.services.keys() & hidden == shown
            assert "/gazebo/spawn_urdf_model" in app.services


def test_read_only_and_allow_exclude_each_other(world: Runtime) -> None:
    for kind in ("websocket", "foxglove"):
        with (
            pytest.raises(SlidectlError, match="exclude each other"),
            running_gateway(world, kind, read_only=True, allow=["code"]),
        ):
            pass


def urdf(name: str, mesh: str, kind: str = "collision") -> str:
    shape = f'<{kind}><geometry><mesh filename="{mesh}"/></geometry></{kind}>'
    return f'<robot name="{name}"><link name="base">{INERTIAL}{shape}</link></robot>'


def test_the_daemon_looks_at_no_file_for_a_client_of_a_gateway(world: Runtime, tmp_path: Path) -> None:
    there = tmp_path / "there.obj"
    there.write_text(TETRAHEDRON)
    with running_gateway(world, "websocket") as url, RosbridgeClient(url) as browser, world.client() as owner:
        texts = set()
        for place in (there, tmp_path / "missing.obj"):  # not even whether it is there
            answer = browser.call("/gazebo/spawn_urdf_model", model_name="a", model_xml=urdf("a", f"file://{place}"))
            assert not answer["values"]["success"]
            texts.add(answer["values"]["status_message"].replace(str(place), "FILE"))
        assert len(texts) == 1
        assert "may not name files" in texts.pop()
        for source in (f"file://{tmp_path}/world.sdf", "model://a_box", "package://rrbot_description"):
            answer = browser.call(
                "/gazebo/spawn_sdf_model",
                model_name="a",
                model_xml=f"<sdf><include><uri>{source}</uri></include></sdf>",
            )
            assert "may not name files" in answer["values"]["status_message"], source
        note = {"files": ["x"], "lines": [[0, 1, 1, 1, 1, 1, 1, 1, 1]], "meshes": [[6, str(there)]]}
        text = f"{urdf('a', 'x.obj')}\n<?slidectl-source {json.dumps(note)}?>"
        answer = browser.call("/gazebo/spawn_urdf_model", model_name="a", model_xml=text)
        assert "may not name files" in answer["values"]["status_message"]
        assert browser.call("/slidectl/spawn_entity", name="s2", entity_resource={"uri": "slider"})["result"]
        owner.call("/gazebo/delete_model", {"model_name": "s2"})
        assert owner.call("/gazebo/spawn_urdf_model", {"model_name": "a", "model_xml": urdf("a", f"file://{there}")})[
            "success"
        ]
        owner.call("/gazebo/delete_model", {"model_name": "a"})


def test_a_robot_of_a_client_has_no_files_after_a_snapshot_either(world: Runtime, tmp_path: Path) -> None:
    with world.client() as client, world.client() as owner:
        client.restrict("reads", "writes")
        mesh = tmp_path / "a.obj"
        mesh.write_text(TETRAHEDRON)
        client.call("/gazebo/spawn_urdf_model", {"model_name": "v", "model_xml": urdf("v", f"file://{mesh}", "visual")})

        def flags() -> dict[str, bool]:
            scene = owner.call("/slidectl/scene")
            return dict(zip(scene["robots"], scene["may_use_files"], strict=True))

        assert flags()["v"] is False
        owner.call("/slidectl/save", {"name": "v", "file": str(tmp_path / "v.snapshot")})
        owner.call("/gazebo/delete_model", {"model_name": "v"})
        owner.call("/slidectl/load", {"file": str(tmp_path / "v.snapshot")})
        assert flags()["v"] is False
        assert flags()["slider"] is True
        owner.call("/gazebo/delete_model", {"model_name": "v"})


# --- files that Foxglove serves -------------------------------------------------------------------------------------


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with a mesh, a material and a picture beside it, and secrets outside of it."""
    (tmp_path / "secret.stl").write_bytes(b"SECRET")
    (tmp_path / "secret.png").write_bytes(b"SECRET")
    folder = tmp_path / "own_robot"
    (folder / "meshes").mkdir(parents=True)
    (folder / "package.xml").write_text("<package><name>own_robot</name></package>")
    (folder / "meshes/body.obj").write_text(f"mtllib body.mtl\nmtllib ../../secret.png\n{TETRAHEDRON}")
    (folder / "meshes/body.mtl").write_text("newmtl a\nmap_Kd skin.png\nmap_Ka link.png\n")
    (folder / "meshes/skin.png").write_bytes(b"SKIN")
    (folder / "meshes/link.png").symlink_to(tmp_path / "secret.png")
    (folder / "meshes/link.stl").symlink_to(tmp_path / "secret.stl")
    return folder


def test_foxglove_serves_files_of_the_owners_models_and_no_link_out_of_them(world: Runtime, package: Path) -> None:
    body, link = (f"file://{package}/meshes/{name}" for name in ("body.obj", "link.stl"))
    shapes = "".join(f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>' for mesh in (body, link))
    (package / "own.urdf").write_text(f'<robot name="own"><link name="base">{INERTIAL}{shapes}</link></robot>')
    with world.client() as owner, running_gateway(world, "foxglove") as address, FoxgloveApp(address) as app:
        owner.spawn(str(package / "own.urdf"))
        try:
            assert app.fetch(body)["data"].startswith(b"mtllib")
            assert app.fetch(body.replace(".obj", ".mtl"))["data"].startswith(b"newmtl")
            assert app.fetch(body.replace("body.obj", "skin.png"))["data"] == b"SKIN"
            for uri in (link, body.replace("body.obj", "link.png"), f"file://{package.parent}/secret.png"):
                answer = app.fetch(uri)
                assert (answer["is_there"], "no asset" in answer["error"]) == (False, True), uri
        finally:
            owner.call("/gazebo/delete_model", {"model_name": "own"})


def test_foxglove_serves_nothing_of_a_robot_that_a_client_spawned(world: Runtime, package: Path) -> None:
    with ExitStack() as stack:
        address = stack.enter_context(running_gateway(world, "foxglove"))
        app, owner = stack.enter_context(FoxgloveApp(address)), stack.enter_context(world.client())
        meshes = [f"file://{package}/meshes/{name}" for name in ("body.obj", "link.stl")]
        with world.client() as client:
            client.restrict("reads", "writes")
            for number, mesh in enumerate(meshes):
                request = {"model_name": f"theirs{number}", "model_xml": urdf(f"r{number}", mesh, "visual")}
                assert client.call("/gazebo/spawn_urdf_model", request)["success"]
        for mesh in meshes:
            assert not app.fetch(mesh)["is_there"]
        for number in range(len(meshes)):
            owner.call("/gazebo/delete_model", {"model_name": f"theirs{number}"})
