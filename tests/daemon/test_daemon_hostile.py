"""What clients do wrong, on purpose or not: the daemon answers, forgets them, and lives."""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from daemon_fixture import Runtime, knows_peers
from rosbridge_wire import Wire

from slidectl import Client, description
from slidectl.errors import SlidectlError
from slidectl.wire.json_lines import LONGEST_LINE

Connect = Callable[[], Wire]
NESTED = b"[" * 600 + b"NaN" + b"]" * 600


def resident_bytes(pid: int) -> int:
    """Memory of the process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize(
    "line",
    [
        b"this is no JSON",
        b"{",
        b'"text"',
        b"[1, 2]",
        b"null",
        b"\xff\xfe\x00",
        b'{"topic": "/x"}',
        b'{"op": 7}',
        b'{"op": null}',
        b'{"op": "fly"}',
        b'{"op": "publish"}',
        b'{"op": "publish", "topic": 5, "msg": {}}',
        b'{"op": "publish", "topic": "/clock", "msg": [1, [2]]}',
        b'{"op": "publish", "topic": "/clock", "msg": "text"}',
        b'{"op": "publish", "topic": "not//legal", "msg": {}}',
        b'{"op": "subscribe", "topic": "/nobody/knows/it"}',
        b'{"op": "subscribe", "topic": "/clock", "queue_length": "many"}',
        b'{"op": "subscribe", "topic": "/clock", "throttle_rate": -1}',
        b'{"op": "subscribe", "topic": "/clock", "throttle_rate": NaN}',
        b'{"op": "subscribe", "topic": "/clock", "compression": "png"}',
        b'{"op": "subscribe", "topic": "/clock", "type": ["a"]}',
        b'{"op": "subscribe", "topic": "/x", "type": "no_such/Type"}',
        b'{"op": "unsubscribe", "topic": "/clock"}',
        b'{"op": "advertise", "topic": "/x", "type": "no_such/Type"}',
        b'{"op": "unadvertise", "topic": "/clock"}',
        b'{"op": "advertise_service", "service": "/slidectl/status", "type": "std_srvs/Empty"}',
        b'{"op": "unadvertise_service", "service": "/slidectl/status"}',
        b'{"op": "service_response", "id": {}}',
        b'{"op": "call_service"}',
        b'{"op": "set_level"}',
        b'{"op": "publish", "topic": "/clock", "msg": {"clock": {"secs": 1e400}}}',
        b'{"op": "subscribe", "topic": "/clock", "throttle_rate": 1' + b"0" * 400 + b"}",
        b'{"op": "call_service", "service": ' + NESTED + b"}",
        b'{"op": "publish", "topic": "/clock", "msg": {}, "id": ' + NESTED + b"}",
        b'{"op": "set_level", "level": "none", "id": ' + b'"' + b"i" * 1001 + b'"}',
        b'{"op": ' + NESTED + b"}",
        b"[" * 100_000,
        b'{"a":' * 50_000,
    ],
    ids=lambda line: line[:60].decode(errors="replace"),
)
def test_nonsense_is_answered_with_a_status_and_the_connection_lives_on(wire: Wire, line: bytes) -> None:
    wire.raw(line + b"\n")
    status = wire.receive()
    assert (status["op"], status["level"]) == ("status", "error")
    assert status["msg"]
    assert "internal error" not in status["msg"]
    assert wire.call("/rosapi/get_time")["result"] is True


@pytest.mark.parametrize("args", [5, "text", [[[]]], {"cycles": {}}, {"cycles": -1}, {"cycles": 1e300}, [None] * 9])
def test_wrong_arguments_fail_the_call_and_nothing_else(wire: Wire, args: object) -> None:
    wire.send(op="call_service", id="x", service="/slidectl/step", args=args)
    answer = wire.receive()
    assert (answer["op"], answer["id"], answer["result"]) == ("service_response", "x", False)
    assert "internal error" not in answer["values"]


def test_ids_of_any_kind_come_back_as_they_were(wire: Wire) -> None:
    for given in (7, "seven", None, [7], {"seven": 7}):
        wire.send(op="call_service", id=given, service="/rosapi/get_time")
        assert wire.receive()["id"] == given
        wire.send(op="subscribe", id=given, topic="/clock")
        wire.send(op="unsubscribe", id=given, topic="/clock")
        assert wire.call("/rosapi/get_time")["result"] is True


@pytest.mark.parametrize("line", [NESTED, b'"' + b"i" * 1_000_000 + b'"'], ids=["nested", "long"])
def test_an_id_that_cannot_be_told_back_stops_no_world(wire: Wire, line: bytes) -> None:
    wire.raw(b'{"op": "call_service", "service": "/slidectl/sleep", "args": {"duration": 0.01}, "id": ' + line + b"}\n")
    answer = wire.receive()
    assert (answer["op"], answer["result"], "id" in answer) == ("service_response", False, False)
    assert answer["values"].startswith("an id of more than ")
    assert wire.call("/slidectl/step", cycles=50)["result"] is True
    assert wire.call("/slidectl/status")["values"]["trouble"] == ""


def test_calls_that_wait_are_bounded(wire: Wire) -> None:
    for number in range(1001):
        wire.send(op="call_service", id=number, service="/slidectl/sleep", args={"duration": 1e6})
    answer = wire.receive()
    assert (answer["id"], answer["result"]) == (1000, False)
    assert answer["values"].startswith("1000 calls of this connection wait for their answers")
    assert wire.call("/rosapi/get_time")["values"].startswith("1000 calls")


def test_a_provider_that_does_not_read_gets_no_more_calls(wire: Wire, connect: Connect) -> None:
    provider = connect()
    provider.send(op="advertise_service", service="/deaf", type="rosapi/SearchParam")
    assert provider.call("/rosapi/get_time")["result"] is True
    for _ in range(100):
        wire.send(op="call_service", service="/deaf", args={"name": "n" * 100_000})
    answer = wire.receive()
    assert (answer["service"], answer["result"]) == ("/deaf", False)
    assert answer["values"].endswith("which provides /deaf, does not read its calls")


def test_a_line_of_100_mb_is_refused_and_never_kept(daemon: Runtime, connect: Connect) -> None:
    wire = connect()
    assert daemon.pid is not None
    before = resident_bytes(daemon.pid)
    assert feed_until_hung_up(wire, 100_000_000) < 100_000_000
    status = wire.receive()
    assert (status["level"], str(LONGEST_LINE) in status["msg"]) == ("error", True)
    with pytest.raises((EOFError, ConnectionError)):
        wire.receive()
    assert resident_bytes(daemon.pid) - before < 3 * LONGEST_LINE
    assert connect().call("/rosapi/get_time")["result"] is True


def feed_until_hung_up(wire: Wire, most: int) -> int:
    """Send bytes without an end of line; how many were taken before the daemon closed the connection."""
    block = b"x" * 1_000_000
    for taken in range(0, most, len(block)):
        try:
            wire.raw(block)
        except (BrokenPipeError, ConnectionResetError):
            return taken
    return most


def test_a_line_that_is_cut_off_is_answered_when_the_client_still_listens(wire: Wire) -> None:
    wire.raw(b'{"op": "publish", "topic": "/cl')
    wire.socket.shutdown(socket.SHUT_WR)
    assert "cut off" in wire.receive()["msg"]
    with pytest.raises(EOFError):
        wire.receive()


def test_what_a_client_said_before_it_vanished_is_carried_out(connect: Connect) -> None:
    listener, hasty = connect(), connect()
    listener.send(op="subscribe", topic="/testament", type="std_msgs/Int32")
    listener.call("/rosapi/get_time")
    lines = [{"op": "publish", "topic": "/testament", "msg": {"data": number}} for number in range(500)]
    complaints = [{"op": "publish", "topic": "/testament", "msg": {"wrong": number}} for number in range(500)]
    hasty.raw(
        b"".join(json.dumps(line).encode() + b"\n" for pair in zip(lines, complaints, strict=True) for line in pair)
    )
    hasty.close()
    assert [listener.receive()["msg"]["data"] for _ in range(500)] == list(range(500))


def test_clients_that_vanish_in_the_middle_of_a_stream_leave_nothing_behind(connect: Connect) -> None:
    for _ in range(30):
        victim = connect()
        victim.send(op="subscribe", topic="/clock")
        victim.send(op="advertise", topic="/victim", type="std_msgs/String")
        victim.send(op="advertise_service", service="/victim_service", type="std_srvs/Trigger")
        victim.send(op="call_service", id="s", service="/slidectl/step", args={"cycles": 500})
        victim.until("publish")
        # Hang up without reading what is there: the daemon's next send fails with a reset.
        victim.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        victim.close()
    onlooker = connect()
    assert onlooker.call("/rosapi/subscribers", topic="/clock")["values"]["subscribers"] == []
    assert "/victim" not in onlooker.call("/rosapi/topics")["values"]["topics"]
    assert "/victim_service" not in onlooker.call("/rosapi/services")["values"]["services"]


def test_steps_that_nobody_waits_for_any_more_are_given_up(connect: Connect) -> None:
    hasty, patient = connect(), connect()
    hasty.send(op="call_service", id="s", service="/slidectl/step", args={"cycles": 10**12})
    hasty.call("/rosapi/get_time")
    hasty.close()
    patient.call("/slidectl/step", cycles=1)
    before = patient.call("/slidectl/status")["values"]["cycles"]
    patient.call("/slidectl/step", cycles=1)
    assert patient.call("/slidectl/status")["values"]["cycles"] == before + 1


def test_a_subscriber_that_does_not_read_keeps_the_newest_and_holds_up_nobody(connect: Connect) -> None:
    sleeper, driver = connect(), connect()
    sleeper.send(op="subscribe", topic="/clock", queue_length=10)
    sleeper.call("/rosapi/get_time")
    for _ in range(10):
        assert driver.call("/slidectl/step", cycles=2000)["values"]["success"] is True
    end = driver.call("/rosapi/get_time")["values"]["time"]
    received, dropped = 0, 0
    while True:
        message = sleeper.receive()
        received += message["op"] == "publish"
        dropped += message.get("dropped", 0)
        if message.get("msg", {}) == {"clock": end}:
            break
    assert dropped > 0
    assert received + dropped == 20_000


def test_fifty_readers_that_stop_cost_no_memory_of_their_own_and_the_others_nothing(
    runtime: Runtime,
) -> None:
    # Of its own: what other tests have sent is not counted. And compiled code, which is loaded meanwhile, has 50 MiB.
    runtime.start(paused=True, engine="plain")
    topics = ("/clock", "/gazebo/model_states", "/gazebo/link_states")
    with ExitStack() as stack:
        *sleepers, reader, driver = [stack.enter_context(Wire(runtime.paths.socket)) for _ in range(52)]
        for each in (*sleepers, reader):
            for topic in topics:
                each.send(op="subscribe", topic=topic, queue_length=2000 if each is reader else 100)
            each.call("/rosapi/get_time")
        assert runtime.pid is not None
        driver.call("/slidectl/step", cycles=1500)
        before = resident_bytes(runtime.pid)
        received = read_clocks(reader, driver.call("/rosapi/get_time")["values"]["time"])
        for _ in range(4):
            driver.call("/slidectl/step", cycles=500)
            received += read_clocks(reader, driver.call("/rosapi/get_time")["values"]["time"])
        assert resident_bytes(runtime.pid) - before < 8 * 2**20
        times = [
            message["msg"]["clock"]
            for message in received
            if message["op"] == "publish" and message["topic"] == "/clock"
        ]
        assert len(times) == len({(time["secs"], time["nsecs"]) for time in times}) == 3_500
        assert not any("dropped" in message for message in received)
        for sleeper in sleepers:
            late = read_clocks(sleeper, driver.call("/rosapi/get_time")["values"]["time"])
            told = sum(
                message["dropped"] for message in late if message.get("dropped") and message["topic"] == "/clock"
            )
            assert told > 0
            assert told + sum(message["op"] == "publish" and message["topic"] == "/clock" for message in late) == 3_500


def read_clocks(wire: Wire, end: dict[str, int]) -> list[dict[str, Any]]:
    """All that comes up to the clock's message of this time."""
    messages = [wire.receive()]
    while messages[-1].get("topic") != "/clock" or messages[-1].get("msg") != {"clock": end}:
        messages.append(wire.receive())
    return messages


def test_a_reader_may_change_its_throttle_and_loses_nothing_of_what_was_sent_before(connect: Connect) -> None:
    reader, writer = connect(), connect()
    writer.send(op="advertise", topic="/counted", type="std_msgs/Int32")
    writer.call("/rosapi/get_time")

    def publish(*numbers: int) -> None:
        for number in numbers:
            writer.send(op="publish", topic="/counted", msg={"data": number})
        writer.call("/rosapi/get_time")

    reader.send(op="subscribe", id="all", topic="/counted")
    reader.send(op="subscribe", id="some", topic="/counted", throttle_rate=1_000_000)
    reader.call("/rosapi/get_time")
    publish(1, 2, 3)
    reader.send(op="unsubscribe", id="all", topic="/counted")
    reader.send(op="call_service", id="throttled", service="/rosapi/get_time")
    messages = read_until_answer(reader, "throttled")
    publish(4, 5, 6)
    reader.send(op="subscribe", id="all", topic="/counted")
    reader.send(op="call_service", id="end", service="/rosapi/get_time")
    messages += read_until_answer(reader, "end")
    publish(7, 8)
    messages += [reader.receive(), reader.receive()]
    numbers = [message["msg"]["data"] for message in messages if message["op"] == "publish"]
    assert numbers == [1, 2, 3, 4, 6, 7, 8]  # the newest of those that were held back comes too


def read_until_answer(wire: Wire, call_id: str) -> list[dict[str, Any]]:
    """All that comes before the answer."""
    messages = []
    while (message := wire.receive()).get("id") != call_id:
        messages.append(message)
    return messages


def test_a_client_that_asks_and_does_not_read_is_not_listened_to_until_it_does(
    daemon: Runtime, connect: Connect
) -> None:
    greedy, modest = connect(), connect()
    question = b'{"op":"call_service","service":"/rosapi/services"}\n'
    asked = send_until_not_listened_to(greedy, question, modest)
    assert daemon.pid is not None
    assert resident_bytes(daemon.pid) < 200 * 2**20
    greedy.socket.setblocking(True)
    answers = [greedy.receive() for _ in range(asked // len(question))]
    assert all(answer["result"] is True for answer in answers)


def test_answers_that_are_not_read_are_bounded_by_one_beyond_the_bound(daemon: Runtime, connect: Connect) -> None:
    greedy, modest = connect(), connect()
    text = "x" * 4_000_000
    assert modest.call("/rosapi/set_param", name="/large", value=json.dumps(text))["result"]
    assert daemon.pid is not None
    before = resident_bytes(daemon.pid)
    call = b'{"op": "call_service", "service": "/rosapi/get_param", "args": {"name": "/large"}}\n'
    greedy.raw((call + b'{"op": "publish", "topic": "/nobody/knows", "msg": {}}\n') * 200)
    for _ in range(10):
        assert modest.call("/rosapi/get_time")["result"] is True
    assert resident_bytes(daemon.pid) - before < 60 * 2**20
    for _ in range(200):
        assert len(greedy.receive()["values"]["value"]) == len(text) + 2
        assert greedy.receive()["level"] == "error"
    assert modest.call("/rosapi/delete_param", name="/large")["result"]


def test_late_answers_to_one_who_does_not_read_are_given_up_and_told(daemon: Runtime, connect: Connect) -> None:
    provider, greedy = connect(), connect()
    provider.send(op="advertise_service", service="/large", type="rosapi/GetParam")
    provider.call("/rosapi/get_time")
    for number in range(50):
        greedy.send(op="call_service", id=number, service="/large", args={})
    calls = [provider.until("call_service") for _ in range(50)]
    assert daemon.pid is not None
    before = resident_bytes(daemon.pid)
    for call in calls:
        provider.send(op="service_response", id=call["id"], service="/large", values={"value": "x" * 4_000_000})
    provider.call("/rosapi/get_time")
    assert resident_bytes(daemon.pid) - before < 80 * 2**20
    answers = [greedy.receive() for _ in range(50)]
    assert [answer["id"] for answer in answers] == list(range(50))
    lost = [answer for answer in answers if not answer["result"]]
    assert 0 < len(lost) < 50
    assert all("does not read its answers" in answer["values"] for answer in lost)


def test_one_that_says_no_more_still_gets_its_answers_and_messages(connect: Connect) -> None:
    half, driver = connect(), connect()
    half.send(op="subscribe", topic="/clock")
    half.send(op="call_service", id="a", service="/rosapi/get_time")
    half.socket.shutdown(socket.SHUT_WR)
    assert half.until("service_response", id="a")["result"] is True
    driver.call("/slidectl/step", cycles=3)
    assert [half.until("publish")["topic"] for _ in range(3)] == ["/clock"] * 3


def test_one_that_reads_no_more_is_let_go_and_what_it_said_is_done(connect: Connect) -> None:
    listener, deaf = connect(), connect()
    listener.send(op="subscribe", topic="/last", type="std_msgs/Int32")
    listener.call("/rosapi/get_time")
    deaf.socket.shutdown(socket.SHUT_RD)
    for number in range(100):
        deaf.send(op="publish", topic="/last", msg={"data": number})
    assert [listener.receive()["msg"]["data"] for _ in range(100)] == list(range(100))
    deaf.close()


def test_a_client_that_is_stopped_holds_up_nobody_and_goes_on_where_it_was(daemon: Runtime, connect: Connect) -> None:
    script = (
        "import sys\nfrom slidectl.client import Client\nclient = Client(socket=sys.argv[1], timeout=60)\n"
        "subscription = client.subscribe('/clock')\nprint('subscribed', flush=True)\nsys.stdin.readline()\n"
        "number = sum(1 for _ in zip(range(2000 - 1), iter(subscription))) + 1 + subscription.dropped\n"
        "print('answered', client.call('/rosapi/get_time')['time']['secs'] >= 0, flush=True)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, str(daemon.paths.socket)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=daemon.env,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "subscribed\n"
        process.send_signal(signal.SIGSTOP)
        driver = connect()
        for _ in range(5):
            assert driver.call("/slidectl/step", cycles=2000)["values"]["success"] is True
        process.send_signal(signal.SIGCONT)
        process.stdin.write("\n")
        process.stdin.flush()
        driver.call("/slidectl/step", cycles=2000)
        assert process.stdout.readline() == "answered True\n"


def send_until_not_listened_to(greedy: Wire, question: bytes, modest: Wire) -> int:
    """Ask and ask until nothing more is taken, though the daemon has had time for others. Returns the bytes sent."""
    greedy.socket.setblocking(False)
    stream, asked = question * 1000, 0
    for _ in range(100_000):
        try:
            asked += greedy.socket.send(stream[asked % len(question) :])
        except BlockingIOError:
            for _ in range(5):
                assert modest.call("/rosapi/get_time")["result"] is True
            if not select.select([], [greedy.socket], [], 0)[1]:
                return asked
    raise AssertionError(f"the daemon took {asked} bytes of questions")


def test_connections_beyond_what_the_process_can_hold_wait_for_their_turn(runtime: Runtime) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))
    try:
        runtime.start(paused=True)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    clients = [Wire(runtime.paths.socket) for _ in range(80)]
    assert clients[0].call("/rosapi/get_time")["result"] is True
    for client in clients[:-1]:
        client.close()
    assert clients[-1].call("/rosapi/get_time")["result"] is True
    clients[-1].close()


@knows_peers
@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_process_of_another_user_is_turned_away_with_a_word(runtime: Runtime) -> None:
    runtime.start(paused=True)
    for path in (runtime.folder, runtime.paths.folder.parent, runtime.paths.folder):
        path.chmod(0o755)  # as if somebody had opened the folder: the credentials must still hold
    runtime.paths.socket.chmod(0o666)
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        os.setuid(65534)
        with socket.socket(socket.AF_UNIX) as stranger:
            stranger.connect(str(runtime.paths.socket))
            os.write(write_end, stranger.recv(4096) + b"|" + stranger.recv(4096))
        os._exit(0)
    os.waitpid(child, 0)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as told:
        line, _, rest = told.read().partition(b"|")
    assert "may not use it" in json.loads(line)["msg"]
    assert rest == b""
    runtime.paths.folder.chmod(0o700)
    assert "refused a connection" in runtime.log


# --- files that clients name ------------------------------------------------------------------------------------------


def _socket_file(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        before = Path.cwd()
        os.chdir(path.parent)  # a socket's path is short
        try:
            one.bind(path.name)
        finally:
            os.chdir(before)


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


HOSTILE_FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "a pipe without a writer": (os.mkfifo, "is a pipe, and only regular files are read"),
    "an endless device": (lambda path: path.symlink_to("/dev/zero"), "is a device, and only regular files are read"),
    "a folder": (Path.mkdir, "is a folder, and only regular files are read"),
    "a socket": (_socket_file, "is a socket, and only regular files are read"),
    "a file of a TiB": (_sparse, "is larger than"),
}


@pytest.mark.parametrize("kind", HOSTILE_FILES)
def test_a_file_that_blocks_or_never_ends_is_refused_and_holds_up_nobody(
    daemon: Runtime, tmp_path: Path, kind: str
) -> None:
    make, said = HOSTILE_FILES[kind]
    files = {suffix: tmp_path / f"named.{suffix}" for suffix in ("py", "snapshot", "urdf", "sdf", "stl")}
    for path in files.values():
        make(path)
    of_robot = {"class_name": "Law", "robot": "slider"}
    (tmp_path / "law.py").write_text(LAW)
    with daemon.client() as client:
        client.call("/gazebo/spawn_urdf_model", {"model_name": "slider", "model_xml": description.load("slider").xml})
        parameter = json.dumps({"joint": "joint1"})
        client.call("/rosapi/set_param", {"name": "/slider/mine", "value": parameter})
        request = {"name": "mine", "file": str(files["py"]), **of_robot}
        refused(client, "/slidectl/load_controller_file", request, said)
        assert client.call("/slidectl/load_controller_file", {**request, "file": str(tmp_path / "law.py")})["ok"]
        (tmp_path / "law.py").unlink()
        make(tmp_path / "law.py")
        refused(client, "/slidectl/reload_controller", {"robot": "slider", "name": "mine"}, said)
        refused(client, "/slidectl/load", {"file": str(files["snapshot"])}, said)
        for suffix in ("urdf", "sdf"):
            resource_of = {"name": "x", "entity_resource": {"uri": str(files[suffix])}}
            answer = client.call("/slidectl/spawn_entity", resource_of)
            assert said in answer["result"]["error_message"] or "no resource" in answer["result"]["error_message"]
        sdf = f'<sdf version="1.6"><include><uri>{files["sdf"]}</uri></include></sdf>'
        answer = client.call("/gazebo/spawn_sdf_model", {"model_name": "x", "model_xml": sdf})
        assert not answer["success"]
        xml = MESH.format(files["stl"])
        answer = client.call("/gazebo/spawn_urdf_model", {"model_name": "x", "model_xml": xml})
        assert not answer["success"]
        client.call("/gazebo/delete_model", {"model_name": "slider"})
    assert "Traceback" not in daemon.log


LAW = """
from slidectl.control import Controller, EffortJointInterface

class Law(Controller):
    interface_type = EffortJointInterface

    def init(self, interface, node):
        return True

    def update(self, time_ns, period_s):
        pass
"""
MESH = (
    '<robot name="x"><link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
    'iyz="0"/></inertial><collision><geometry><mesh filename="file://{}"/></geometry></collision></link></robot>'
)


def refused(client: Client, service: str, request: dict[str, Any], said: str) -> None:
    with pytest.raises(SlidectlError) as caught:
        client.call(service, request)
    assert said in str(caught.value)
