"""Who is let in: tokens, pages of other sites, names of this machine, TLS, readers; and what stops the start."""

from __future__ import annotations

import ast
import asyncio
import inspect
import json
import socket
import ssl
import warnings
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from daemon_fixture import Runtime, running_daemon
from raw_websocket import descriptors, gateway_pid, raw_socket
from rosbridge_client import DEADLINE_S, RosbridgeClient
from running_gateway import running_gateway
from waiting import eventually
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidMessage, InvalidStatus

from slidectl import web_access
from slidectl.errors import SlidectlError

TOKEN = "a.word-of_8~or-more"


@pytest.fixture(scope="module")
def world() -> Iterator[Runtime]:
    with running_daemon(paused=True) as runtime:
        yield runtime


def answer(url: str, **options: Any) -> tuple[int, str]:
    """Status and text of a handshake; (101, "") when it was let in and works."""

    async def call() -> tuple[int, str]:
        # Not the client with threads: it reads in one and writes in another, and OpenSSL serves one at a time.
        try:
            async with connect(url, open_timeout=DEADLINE_S, **options) as browser:
                await browser.send('{"op": "call_service", "service": "/rosapi/get_time"}')
                assert json.loads(await asyncio.wait_for(browser.recv(), DEADLINE_S))["result"]
                return 101, ""
        except InvalidStatus as error:
            return error.response.status_code, error.response.body.decode()

    return asyncio.run(call())


def test_pages_come_in_that_were_named_and_no_others(world: Runtime) -> None:
    with running_gateway(world, "websocket", origins=["https://lab.example:8443", "null"]) as url:
        assert answer(url) == (101, "")
        for origin in ("https://lab.example:8443", "null"):
            assert answer(url, origin=origin) == (101, ""), origin
        for origin in (
            "http://localhost:8000",
            "http://127.0.0.1",
            "https://[::1]:3000",
            url.replace("ws://", "http://"),
            "https://evil.example",
            "https://lab.example",
            "http://localhost.evil.example",
            "http://[",
            "file://",
        ):
            status, text = answer(url, origin=origin)
            assert (status, "--origin" in text) == (403, True), origin
        status, text = answer(url.replace("localhost", "127.0.0.1"), additional_headers={"Host": "evil.example:9090"})
        assert (status, "evil.example" in text) == (403, True)
    with running_gateway(world, "websocket") as url:
        assert answer(url, origin="null")[0] == 403
    with running_gateway(world, "websocket", origins=["*"]) as url:
        assert answer(url, origin="https://evil.example") == (101, "")


def test_a_token_is_asked_for(world: Runtime, tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    for options in ({"token": TOKEN}, {"token_file": str(file)}):
        with running_gateway(world, "websocket", **options) as url:
            assert "Bearer" in answer(url)[1]
            for wrong in (
                "?token=",
                "?token=wrong",
                f"?token={TOKEN}x",
                f"?tokens={TOKEN}",
                "?token=%FF%00",
                "?" + "t=1&" * 1000,
            ):
                assert answer(f"{url}/{wrong}")[0] == 401, wrong
            for header in (f"Bearer {TOKEN[:-1]}", "Basic abc", "Bearer", f"Token {TOKEN}", "Bearer \u00ff"):
                assert answer(url, additional_headers={"Authorization": header})[0] == 401, header
            assert answer(f"{url}/?token={TOKEN}") == (101, "")
            assert answer(url, additional_headers={"Authorization": f"Bearer {TOKEN}"}) == (101, "")
            assert answer(f"{url}/?token={TOKEN}", origin="https://evil.example")[0] == 403


def test_a_reader_changes_nothing(world: Runtime) -> None:
    with running_gateway(world, "websocket", read_only=True) as url, RosbridgeClient(url) as browser:
        browser.send(op="subscribe", topic="/clock")
        assert browser.call("/rosapi/subscribers", topic="/clock")["values"]["subscribers"]
        for service in ("/rosapi/topics", "rosapi/nodes", "/slidectl/status", "/gazebo/get_world_properties"):
            assert browser.call(service)["result"], service
        for service in (
            "/rosapi/set_param",
            "/gazebo/reset_world",
            "/slidectl/shutdown",
            "//slidectl/shutdown",
            "/x/../slidectl/shutdown",
        ):
            refused = browser.call(service)
            is_known = not service.startswith(("//", "/x"))
            assert (refused["result"], "--read-only" in refused["values"]) == (False, is_known), service
        for op in (
            "publish",
            "advertise",
            "advertise_service",
            "service_response",
            "send_action_goal",
        ):
            browser.send(op=op, id=op, topic="/x", type="std_msgs/String", msg={}, service="/y", node="/z", action="/a")
            assert "--read-only" in browser.op("status", id=op)["msg"]
        browser.socket.send(
            '{"op":"subscribe","op":"call_service","service":"/rosapi/topics","id":"2","service":"/gazebo/reset_world"}'
        )
        assert not browser.op("service_response", id="2")["result"]
        # What is no JSON as it came must not be passed on and be JSON then.
        browser.socket.send(
            '{"op":"call_service","service":"/rosapi/set_param","id":"\n","args":{"name":"/set","value":"1"}}'
        )
        assert not browser.op("service_response", id=" ")["result"]
        browser.socket.send('{"op":"publish","topic":"/x","type":"std_msgs/Empty"')
        assert "not JSON" in browser.op("status", level="error")["msg"]
        assert not browser.call("/rosapi/has_param", name="/set")["values"]["exists"]
        topics = browser.call("/rosapi/topics")["values"]["topics"]
        assert "/x" not in topics


def certificate(folder: Path, name: str, days: int, password: bytes = b"") -> tuple[str, str]:
    """A certificate of 127.0.0.1 that ends in so many days, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    end = datetime.now(UTC) + timedelta(days=days)
    builder = x509.CertificateBuilder(subject, subject, key.public_key(), x509.random_serial_number())
    names = x509.SubjectAlternativeName([x509.DNSName("localhost"), x509.IPAddress(ip_address("127.0.0.1"))])
    builder = builder.not_valid_before(end - timedelta(days=30)).not_valid_after(end).add_extension(names, False)
    files = folder / f"{name}.pem", folder / f"{name}.key"
    files[0].write_bytes(builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
    lock = serialization.BestAvailableEncryption(password) if password else serialization.NoEncryption()
    pkcs8 = serialization.PrivateFormat.PKCS8
    files[1].write_bytes(key.private_bytes(serialization.Encoding.PEM, pkcs8, lock))
    return str(files[0]), str(files[1])


def test_tls_and_certificates_that_nobody_would_take(world: Runtime, tmp_path: Path) -> None:
    cert, key = certificate(tmp_path, "good", 2)
    trusting = ssl.create_default_context(cafile=cert)
    with running_gateway(world, "websocket", cert=cert, key=key) as url:
        assert url.startswith("wss://localhost:")
        assert answer(url, ssl=trusting) == (101, "")
        with pytest.raises(ssl.SSLCertVerificationError):
            answer(url)
        with pytest.raises(InvalidMessage):  # plain text on the TLS port
            answer(url.replace("wss", "ws"))
        assert answer(url, ssl=trusting) == (101, "")
    both = tmp_path / "both.pem"
    both.write_text(Path(cert).read_text() + Path(key).read_text())
    with running_gateway(world, "websocket", cert=str(both)) as url:
        assert answer(url, ssl=trusting) == (101, "")
    locked = certificate(tmp_path, "locked", 2, b"word")
    expired = certificate(tmp_path, "expired", -2)
    future = certificate(tmp_path, "future", 60)
    for options, text in (
        ({"cert": expired[0], "key": expired[1]}, "certificate has expired"),
        ({"cert": future[0], "key": future[1]}, "certificate is not yet valid"),
        ({"cert": cert, "key": expired[1]}, "not that of the certificate"),
        ({"cert": locked[0], "key": locked[1]}, "encrypted"),
        ({"cert": cert}, "PEM"),
        ({"cert": str(tmp_path / "none.pem"), "key": key}, "no such file"),
        ({"key": key}, "--cert"),
    ):
        assert text in refusal(world, **options)


def test_what_is_no_tls_or_an_old_one_gets_no_answer_and_keeps_nobody_out(world: Runtime, tmp_path: Path) -> None:
    cert, key = certificate(tmp_path, "good", 2)
    trusting = ssl.create_default_context(cafile=cert)
    with running_gateway(world, "websocket", cert=cert, key=key, token=TOKEN) as url, ExitStack() as stack:
        had = descriptors(gateway_pid(world, "websocket"))
        for sent in (b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", b"\x16\x03\x01\xff\xff", b"\0" * 5000, b""):
            with raw_socket(url) as plain:
                plain.sendall(sent)
                plain.shutdown(socket.SHUT_WR)
                assert b"HTTP" not in plain.recv(4096)
        for version in (ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1):
            old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            old.check_hostname, old.verify_mode = False, ssl.CERT_NONE
            old.set_ciphers("DEFAULT:@SECLEVEL=0")  # else the client itself refuses
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)
                old.minimum_version = ssl.TLSVersion.MINIMUM_SUPPORTED
                old.maximum_version = version
            with raw_socket(url) as plain, pytest.raises(OSError):  # noqa: PT011
                old.wrap_socket(plain)
        idle = [stack.enter_context(raw_socket(url)) for _ in range(1000)]
        idle[0].sendall(b"\x16\x03\x01")
        assert answer(f"{url}/?token={TOKEN}", ssl=trusting) == (101, "")
        assert answer(f"{url}/?token={TOKEN}x", ssl=trusting)[0] == 401
        for one in idle:
            one.close()
        eventually(lambda: descriptors(gateway_pid(world, "websocket")) <= had)


def test_tokens_are_compared_in_constant_time() -> None:
    """Nothing but `is_secret` compares a token or what stands for it, and it uses hmac."""
    package = Path(web_access.__file__).parent
    assert "hmac.compare_digest(" in inspect.getsource(web_access.is_secret)
    compared = []
    for path in ("extensions/gateways/websocket_listener.py", "extensions/viewing/page/guarded_server.py"):
        for node in ast.walk(ast.parse((package / path).read_text("utf-8"))):
            if isinstance(node, ast.Compare):
                names = {ast.unparse(part).rpartition(".")[2] for part in (node.left, *node.comparators)}
                compared += names & {"_token", "token", "_session", "_word", "given"} if len(names) > 1 else []
    # `given is None`, and origins, whose spelling is no secret
    assert [name for name in compared if name != "given"] == []


def refusal(world: Runtime, **options: Any) -> str:
    with pytest.raises(SlidectlError) as caught, running_gateway(world, "websocket", **options):
        pass
    return str(caught.value)


def test_what_stops_the_start_is_said(world: Runtime, tmp_path: Path) -> None:
    with running_gateway(world, "websocket") as url:
        port = int(url.rpartition(":")[2])
        with running_daemon(paused=True) as other:
            assert f"port {port} of localhost is taken" in refusal(other, port=port)
            for options, text in (
                ({"host": "no.such.host.invalid"}, "no host"),
                ({"host": "192.0.2.1", "token": TOKEN}, "not an address of this machine"),
                ({"host": "0.0.0.0"}, "--token"),
                ({"token": "short"}, "8 or more"),
                ({"token": TOKEN, "token_file": "x"}, "exclude each other"),
                ({"token_file": str(tmp_path)}, "cannot be read"),
                ({"origins": ["lab.example"]}, "not an origin"),
                ({"origins": ["https://lab.example/page"]}, "not an origin"),
            ):
                assert text in refusal(other, **options), options
            with running_gateway(other, "websocket", host="0.0.0.0", token=TOKEN) as wide:
                assert answer(f"{wide}/?token={TOKEN}", additional_headers={"Host": "robot.lab:9090"}) == (101, "")
