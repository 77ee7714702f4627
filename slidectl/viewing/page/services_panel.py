"""Any service: a form of its request, the call, and the answer as YAML (rqt_service_caller)."""

from __future__ import annotations

import time
from html import escape
from typing import NamedTuple

from viser import GuiFolderHandle

from slidectl.errors import Refused, SlidectlError, cut
from slidectl.msgs.forms import YamlForm
from slidectl.msgs.schema import Schema, from_typedefs
from slidectl.viewing.page.html_table import SCROLLED
from slidectl.viewing.page.message_form import MessageForm
from slidectl.viewing.page.page import Page, Panel, WorldState

_NONE = "none"
_LIST_EVERY_S = 2.0
_LONGEST_WAIT_S = 60.0
_LONGEST_ANSWER = 20_000


class _Call(NamedTuple):
    """What is under way, whatever is chosen meanwhile."""

    id: str
    service: str
    response: Schema
    deadline: float


class ServicesPanel(Panel):
    """One service at a time. The page goes on while it waits for the answer."""

    title = "Services"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._service = _NONE
        self._chosen: dict[str, dict[str, str | bool]] = {}
        """Type -> the values in the form of its request."""
        self._known: list[str] = []
        self._look_at = 0.0
        self._form: MessageForm | None = None
        self._response = Schema("", {})
        self._inputs: GuiFolderHandle | None = None
        self._call: _Call | None = None

    def build(self, world: WorldState) -> None:  # noqa: ARG002
        gui = self.gui
        self._known = self.page.client.services()
        self._service = self._service if self._service in self._known else _NONE
        self._services = gui.add_dropdown("service", (_NONE, *self._known), initial_value=self._service)
        self.page.looking(self._services, self._choose_service)
        self._container = gui.add_folder(None)
        self._inputs = None
        self.page.acting(gui.add_button("Call"), lambda _: self._begin())
        self._answer = gui.add_html("")
        self._make_form()

    def leave(self) -> None:
        self._call = None
        self._form = None

    def refresh(self, world: WorldState) -> None:  # noqa: ARG002
        if time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LIST_EVERY_S
            known = self.page.client.services()
            if known != self._known:
                self._known = known
                self._services.options = (_NONE, *known)
                if self._service not in known:
                    self._choose_service(_NONE)
        client, call = self.page.client, self._call
        if call is not None and client.is_answered(call.id):
            self._call = None
            try:
                text = YamlForm(call.response).printer(call.response.root)(client.answer(call.id)) or "an empty answer"
            except SlidectlError as error:
                self._tell(call.service, f"failed: {error}")
            else:
                remarks = (f"# {line}" for reason in client.reasons for line in reason.splitlines())
                self._tell(call.service, "\n".join([text, *remarks]))
            self.page.look_again()
        elif call is not None and time.monotonic() >= call.deadline:
            client.forget(call.id)
            self._call = None
            self._tell(call.service, f"no answer within {_LONGEST_WAIT_S:g} s")

    def _choose_service(self, service: str) -> None:
        self._service = service
        self._make_form()

    def _make_form(self) -> None:
        if self._inputs is not None:
            self._inputs.remove()
        self._form = self._inputs = None
        if self._service != _NONE:
            found = self.page.client.resolve("service", self._service)
            request, self._response = from_typedefs(found["typedefs"]), from_typedefs(found["response_typedefs"])
            with self._container:
                self._inputs = self.gui.add_folder(found["type"])
            with self._inputs:
                self._form = MessageForm(self.page, request, self._chosen.setdefault(found["type"], {}))

    def _begin(self) -> None:
        if self._form is None:
            raise Refused("no service to call", "choose one")
        if self._call:
            raise Refused("the call before is not answered yet")
        client = self.page.client
        now = client.call("/rosapi/get_time")["time"]
        request = self._form.maker()(0, 0.0, (now["secs"], now["nsecs"]))
        call = client.call_async(self._service, request)
        self._call = _Call(call, self._service, self._response, time.monotonic() + _LONGEST_WAIT_S)
        self._tell(self._service, "calling ...")

    def _tell(self, service: str, text: str) -> None:
        shown = escape(cut(f"{service}\n{text}", _LONGEST_ANSWER), quote=False)
        self._answer.content = f'<pre style="{SCROLLED}">{shown}</pre>'
