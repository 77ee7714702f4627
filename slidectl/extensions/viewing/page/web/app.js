// The page: a toolbar over the scene, panels at both sides, and the state of the world that they share.
// Nothing here draws the scene: viser does, in the element #root of the same document.

import { controllersPanel } from "./panels/controllers.js";
import { graphPanel } from "./panels/graph.js";
import { followLog, logPanel } from "./panels/log.js";
import { plotFromAddress, plotsPanel } from "./panels/plots.js";
import { sendPanel } from "./panels/send.js";
import { topicsPanel } from "./panels/topics.js";
import { viewPanel } from "./panels/view.js";
import { worldPanel } from "./panels/world.js";
import { PictureOverlay } from "./pictures.js";
import {
  act, attempt, Button, call, dismiss, html, number, notify, page, render, Select, store, Typed, useEffect, useStore,
} from "./parts.js";
import { Connection, GONE } from "./ros.js";

const SPEEDS = ["0.1", "0.25", "0.5", "1", "2", "5", "10", "max"];
const LOOK_MS = 1000;
const CLOCK_MS = 100;
const NARROW = matchMedia("(max-width: 1180px)");
const PHONE = matchMedia("(max-width: 700px)");
const DARK = matchMedia("(prefers-color-scheme: dark)");
const LEFT = { robot: controllersPanel, world: worldPanel, view: viewPanel };
const RIGHT = { plots: plotsPanel, topics: topicsPanel, send: sendPanel, log: logPanel, graph: graphPanel };
const PANELS = { ...LEFT, ...RIGHT };

// What slidectl view judges by whether the scene has shadows, and which names of frames overlap.
const BROWSER = { browser: `${Math.random()}`, draws_by_software: drawsBySoftware() };

function drawsBySoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return true;
  const about = gl.getExtension("WEBGL_debug_renderer_info");
  const name = gl.getParameter(about ? about.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

const address = new URLSearchParams(location.search);
const asked = address.get("panel");

store.set({
  ros: null,
  isThere: null, // null: not known yet
  gone: "page", // or daemon: who has gone when it is not there
  status: null,
  robots: [],
  controllers: {}, // namespace -> controller_manager_msgs/ControllerState[]
  topics: {}, // name -> slidectl/TopicInfo
  services: {}, // name -> slidectl/ServiceInfo
  pageState: null,
  readOnly: false,
  notices: [],
  robot: address.get("robot") ?? "",
  left: asked in LEFT ? asked : "robot",
  right: asked in RIGHT ? asked : "plots",
  phone: asked in PANELS ? asked : "robot",
  leftOpen: !NARROW.matches || !(asked in RIGHT || address.has("plot")),
  rightOpen: !NARROW.matches || asked in RIGHT || address.has("plot"),
  sheetOpen: true,
  theme: localStorage.getItem("slidectl.theme") ?? "system",
  isPhone: PHONE.matches,
  helpOpen: false,
  pictures: [],
  time: null,
  cycles: 1, // of a step
});

// --- the world -------------------------------------------------------------------------------------------------------

let reading = null;
let nextReading = null;

/** Read status, robots, controllers and the page's own state. Calls during a reading share one that begins after it: what
 * they have changed may not be in the answers that are under way. */
function readWorld() {
  if (reading) {
    nextReading ??= reading.then(() => {
      nextReading = null;
      return readWorld();
    });
    return nextReading;
  }
  reading = (async () => {
    try {
      const [status, robots, pageState] = await Promise.all([
        call("/slidectl/status"), call("/slidectl/list_robots", { name: "" }), page("state", { ...BROWSER, pixel_ratio: devicePixelRatio }),
      ]);
      const spaces = robots.robots.filter((one) => one.kind === "robot").map((one) => one.namespace);
      const lists = await Promise.all(spaces.map((space) =>
        call(`${space === "/" ? "" : space}/controller_manager/list_controllers`).catch(() => ({ controller: [] }))));
      const controllers = Object.fromEntries(spaces.map((space, place) => [space, lists[place].controller]));
      const changes = { status, isThere: true, readOnly: pageState.read_only };
      for (const [key, value] of Object.entries({ robots: robots.robots, controllers, pageState })) {
        if (JSON.stringify(value) !== JSON.stringify(store.values[key])) changes[key] = value;
      }
      store.set(changes);
    } catch (error) {
      if (store.values.ros.isOpen && store.values.isThere) notify(error.message, error.hint ?? "", "bad");
    }
  })().finally(() => { reading = null; });
  return reading;
}

async function readGraph() {
  const graph = await call("/slidectl/graph").catch(() => null);
  if (!graph) return;
  const byName = (list) => Object.fromEntries(list.map((one) => [one.name, one]));
  store.set({ topics: byName(graph.topics), services: byName(graph.services) });
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const ros = new Connection(`${scheme}://${location.host}/rosbridge`, (isOpen, gone) => {
    if (isOpen) {
      readWorld();
      readGraph();
    } else {
      store.set({ isThere: false, gone, status: null, robots: [], controllers: {}, topics: {}, services: {} });
    }
  });
  ros.onStatus = (status) => {
    if (status.dropped) return;
    const [text, ...rest] = status.msg.split("\n");
    notify(text, rest.join("\n"), { error: "bad", warning: "warning", info: "good" }[status.level] ?? "");
  };
  store.set({ ros, readWorld, readGraph });
  followLog();
  let timer = null;
  ros.subscribe("/slidectl/graph_changes", () => {
    timer ??= setTimeout(() => {
      timer = null;
      readGraph();
      readWorld();
    }, 200);
  }, { type: "std_msgs/Empty" });
  setInterval(() => document.hidden || reading || (ros.isOpen && readWorld()), LOOK_MS);
  document.addEventListener("visibilitychange", () => !document.hidden && ros.isOpen && readWorld());
}

// --- time ------------------------------------------------------------------------------------------------------------

const toggle = () => act(async () => {
  const { paused } = await call("/slidectl/status");
  await call(paused && !stepping ? "/gazebo/unpause_physics" : "/gazebo/pause_physics");
});

let stepping = false;

/** Step. A pause ends many steps. */
const step = () => act(async () => {
  if (stepping) throw Object.assign(new Error("the world is stepping"), { hint: "Pause ends it" });
  stepping = true;
  try {
    await call("/slidectl/step", { cycles: store.values.cycles });
  } finally {
    stepping = false;
  }
});

const setSpeed = (value) => act(() => call("/slidectl/set_speed", { speed: value === "max" ? 0 : Number(value) }));

const look = (view, robot = "") => attempt(() => page("camera", { view, robot }));

function Toolbar() {
  const status = useStore((s) => s.status);
  const readOnly = useStore((s) => s.readOnly);
  const recording = useStore((s) => s.pageState?.recording);
  const isPhone = useStore((s) => s.isPhone);
  const theme = useStore((s) => s.theme);
  const leftOpen = useStore((s) => s.leftOpen);
  const rightOpen = useStore((s) => s.rightOpen);
  const cycles = useStore((s) => s.cycles);
  const robot = useStore((s) => s.robot);
  const several = useStore((s) => s.robots.length > 1);
  const paused = status?.paused;
  const speed = status ? (status.speed ? String(status.speed) : "max") : "1";
  const speeds = SPEEDS.includes(speed) ? SPEEDS : [...SPEEDS, speed];
  const off = readOnly || !status;
  // After a click the keys are for the simulation again, and not for the button that was clicked.
  const leave = (event) => event.detail && event.target.closest("button")?.blur();
  return html`<div class="toolbar" role="toolbar" aria-label="Simulation" onClick=${leave}>
    ${!isPhone && html`<${Button} icon="left" title=${leftOpen ? "Hide the robot panels" : "Show the robot panels"}
      aria-pressed=${leftOpen} onClick=${() => store.set({ leftOpen: !leftOpen, ...(NARROW.matches && !leftOpen ? { rightOpen: false } : {}) })} />`}
    <${Button} icon=${paused === false ? "pause" : "play"} kind="primary" disabled=${off}
      title=${paused === false ? "Pause (space)" : "Resume (space)"} onClick=${toggle} />
    <${Button} icon="step" title="Step (.)" disabled=${off} onClick=${step} />
    <${Typed} class="cycles" inputmode="numeric" value=${cycles} aria-label="Step length, cycles" title="Step length, cycles"
      disabled=${off} onCommit=${(text) => {
        if (/^\d+$/.test(text) && text >= 1 && text <= 1e6) store.set({ cycles: Number(text) });
        else notify("A step is from 1 to 1000000 cycles long", "", "bad");
      }} />
    <${Clock} />
    <${Select} label="Rate, × real time" title="Rate, × real time" value=${speed} disabled=${off} onChange=${setSpeed}
      options=${speeds.map((one) => [one, one === "max" ? "max" : `${one}×`])} />
    <${Menu} icon="reset" title="Reset" disabled=${off} items=${[
      ["Reset robots", () => act(() => call("/gazebo/reset_world"))],
      ["Reset robots and time", () => act(() => call("/gazebo/reset_simulation"))],
    ]} />
    <${Button} icon=${recording ? "stop" : "record"} kind=${recording ? "recording" : ""} disabled=${off}
      title=${recording ? `Stop recording ${recording.file}` : "Record"} onClick=${toggleRecording} />
    <${Menu} icon="camera" title="Camera" items=${[
      ["From the side above", "iso"], ["Front", "front"], ["Side", "side"], ["Top", "top"],
    ].map(([text, view]) => [text, () => look(view)]).concat(several && robot ? [[`Near ${robot}`, () => look("iso", robot)]] : [])} />
    <${Button} icon=${isDark() ? "sun" : "moon"} title=${`Colours: ${theme}`} onClick=${nextTheme} />
    ${!isPhone && html`<${Button} icon="keys" title="Keys (?)" onClick=${() => store.set({ helpOpen: true })} />`}
    ${!isPhone && html`<${Button} icon="right" title=${rightOpen ? "Hide the data panels" : "Show the data panels"}
      aria-pressed=${rightOpen} onClick=${() => store.set({ rightOpen: !rightOpen, ...(NARROW.matches && !rightOpen ? { leftOpen: false } : {}) })} />`}
  </div>`;
}

function Clock() {
  const status = useStore((s) => s.status);
  const time = useStore((s) => s.time);
  useEffect(() => {
    if (!status) return undefined;
    // Between two readings the time goes on as it did: a subscription of the clock would cost the daemon more.
    const begin = performance.now();
    store.set({ time: status.time });
    if (status.paused) return undefined;
    const goOn = () => document.hidden || store.set({ time: status.time + (status.speed_reached * (performance.now() - begin)) / 1000 });
    const timer = setInterval(goOn, CLOCK_MS);
    return () => clearInterval(timer);
  }, [status]);
  if (!status) return html`<span class="clock">–</span>`;
  const state = status.paused ? "paused" : `${status.speed_reached.toFixed(2)}×`;
  const about = `${status.cycles} cycles of ${status.timestep} s`;
  return html`<span class="clock" title=${about}><b>${number(time)} s</b> <i>${state}</i></span>`;
}

const toggleRecording = () => act(async () => {
  if (store.values.pageState?.recording) return page("stop_recording");
  const two = (value) => String(value).padStart(2, "0");
  const now = new Date();
  const stamp = [now.getHours(), now.getMinutes(), now.getSeconds()].map(two).join("");
  return page("record", { file: `run-${now.getFullYear()}${two(now.getMonth() + 1)}${two(now.getDate())}-${stamp}.bag` });
});

function Menu({ icon, title, items, disabled }) {
  const open = useStore((s) => s.menu === title);
  return html`<span class="menu">
    <${Button} icon=${icon} title=${title} disabled=${disabled} aria-haspopup="menu" aria-expanded=${open}
      onClick=${(event) => { event.stopPropagation(); store.set({ menu: open ? "" : title }); }} />
    ${open && html`<div class="items" role="menu">${items.map(([text, action]) =>
      html`<button type="button" role="menuitem" onClick=${action}>${text}</button>`)}</div>`}
  </span>`;
}

// --- colours ---------------------------------------------------------------------------------------------------------

const isDark = () => (store.values.theme === "system" ? DARK.matches : store.values.theme === "dark");

function nextTheme() {
  const other = isDark() ? "light" : "dark";
  const theme = (other === "dark") === DARK.matches ? "system" : other;
  store.set({ theme });
  if (theme === "system") localStorage.removeItem("slidectl.theme");
  else localStorage.setItem("slidectl.theme", theme);
  applyTheme();
}

function applyTheme() {
  document.documentElement.dataset.theme = isDark() ? "dark" : "light";
  store.set({ dark: isDark() });
}

// --- the frame -------------------------------------------------------------------------------------------------------

function Tabs({ panels, chosen, onChoose, label }) {
  const onKey = (event) => {
    const keys = Object.keys(panels);
    const to = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!to) return;
    const next = keys[(keys.indexOf(chosen) + to + keys.length) % keys.length];
    onChoose(next);
    event.currentTarget.querySelector(`[data-panel="${next}"]`)?.focus();
    event.stopPropagation();
  };
  return html`<div class="tabs" role="tablist" aria-label=${label} onKeyDown=${onKey}>
    ${Object.entries(panels).map(([key, one]) => html`<button type="button" role="tab" key=${key} data-panel=${key}
      id=${`tab-${key}`} aria-controls=${`panel-${key}`} aria-selected=${key === chosen}
      tabindex=${key === chosen ? 0 : -1} onClick=${() => onChoose(key)}>${one.title}</button>`)}
  </div>`;
}

function Dock({ side, panels, chosen, onChoose, label }) {
  const isThere = useStore((s) => s.isThere);
  const gone = useStore((s) => s.gone);
  const Shown = panels[chosen].Panel;
  return html`<aside class=${`dock ${side}`} aria-label=${label}>
    <${Tabs} panels=${panels} chosen=${chosen} onChoose=${onChoose} label=${label} />
    <div class="panel" role="tabpanel" id=${`panel-${chosen}`} aria-labelledby=${`tab-${chosen}`} tabindex="0">
      ${isThere || chosen === "log" ? html`<${Shown} key=${chosen} />` : html`<p class="empty">${
        isThere === null ? "Connecting …" : gone === "daemon" ? `${GONE.daemon}. The page comes back with it.` : `${GONE.page}.`}</p>`}
    </div>
  </aside>`;
}

const remembered = (key) => (value) => {
  store.set({ [key]: value });
  const query = new URLSearchParams(location.search);
  query.set("panel", value);
  history.replaceState(null, "", `?${query}`);
};

function Notices() {
  const notices = useStore((s) => s.notices);
  return html`<div class="notices" role="status" aria-live="polite">${notices.map((one) => html`
    <div key=${one.id} class=${`notice ${one.kind}`}><div><b>${one.text}</b>${one.hint && html`<p>${one.hint}</p>`}</div>
      <${Button} icon="close" title="Dismiss" onClick=${() => dismiss(one.id)} /></div>`)}</div>`;
}

function Banner() {
  const isThere = useStore((s) => s.isThere);
  const gone = useStore((s) => s.gone);
  const status = useStore((s) => s.status);
  const readOnly = useStore((s) => s.readOnly);
  if (isThere === false) {
    return html`<div class="banner bad" role="alert">${gone === "daemon"
      ? html`${GONE.daemon}. The page waits for it: <code>slidectl daemon start</code>` : GONE.page}</div>`;
  }
  const told = [
    readOnly && "Read-only: started with --read-only",
    status?.trouble,
    status?.estop?.length && `Emergency stop: ${status.estop.join(", ")}`,
    status?.frozen?.length && `Diverged and held: ${status.frozen.join(", ")}`,
  ].filter(Boolean);
  return told.length ? html`<div class="banner">${told.join(" · ")}</div>` : null;
}

const KEYS = [
  ["Space", "Pause or resume"], [".", "Step"], ["Arrows", "Drive, while the pad is chosen"],
  ["Shift and drag", "Push a link"], ["Drag", "Turn the view"], ["Right button and drag", "Move the view"],
  ["Wheel", "Zoom"], ["?", "These keys"], ["Esc", "Close"],
];

function Help() {
  const open = useStore((s) => s.helpOpen);
  if (!open) return null;
  return html`<div class="shade" onClick=${() => store.set({ helpOpen: false })}>
    <div class="dialog" role="dialog" aria-modal="true" aria-label="Keys" onClick=${(event) => event.stopPropagation()}>
      <header><h2>Keys</h2><${Button} icon="close" title="Close" onClick=${() => store.set({ helpOpen: false })} /></header>
      <dl>${KEYS.map(([key, text]) => html`<dt><kbd>${key}</kbd></dt><dd>${text}</dd>`)}</dl>
    </div></div>`;
}

function App() {
  const isPhone = useStore((s) => s.isPhone);
  const left = useStore((s) => s.left);
  const right = useStore((s) => s.right);
  const phone = useStore((s) => s.phone);
  const leftOpen = useStore((s) => s.leftOpen);
  const rightOpen = useStore((s) => s.rightOpen);
  const sheetOpen = useStore((s) => s.sheetOpen);
  useEffect(() => {
    const { dataset } = document.documentElement;
    dataset.layout = isPhone ? "phone" : "desk";
    dataset.left = String(!isPhone && leftOpen);
    dataset.right = String(!isPhone && rightOpen);
    dataset.sheet = String(isPhone && sheetOpen);
  });
  return html`
    <div class="over"><${Banner} /><${Toolbar} /></div>
    ${isPhone
      ? html`<${Button} kind="sheet-button" onClick=${() => store.set({ sheetOpen: !sheetOpen })}>${
          sheetOpen ? "Hide panels" : "Show panels"}<//>
        ${sheetOpen && html`<${Dock} side="sheet" panels=${PANELS} chosen=${phone} onChoose=${remembered("phone")} label="Panels" />`}`
      : html`${leftOpen && html`<${Dock} side="left" panels=${LEFT} chosen=${left} onChoose=${remembered("left")} label="Robot" />`}
        ${rightOpen && html`<${Dock} side="right" panels=${RIGHT} chosen=${right} onChoose=${remembered("right")} label="Data" />`}`}
    <${PictureOverlay} /><${Notices} /><${Help} />`;
}

// --- keys ------------------------------------------------------------------------------------------------------------

function onKey(event) {
  if (event.key === "Escape") return store.set({ helpOpen: false, menu: "" });
  const typed = "input:not([type=range], [type=checkbox]), select, textarea, [contenteditable]";
  const taken = event.key === " " ? `input, button, summary, ${typed}` : typed; // the space bar presses what has the focus
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.(taken)) return undefined;
  if (event.key === "?") store.set({ helpOpen: !store.values.helpOpen });
  else if (store.values.readOnly || !store.values.status || event.repeat) return undefined;
  else if (event.key === " ") toggle();
  else if (event.key === ".") step();
  else return undefined;
  return event.preventDefault();
}

applyTheme();
DARK.addEventListener("change", applyTheme);
PHONE.addEventListener("change", () => store.set({ isPhone: PHONE.matches }));
NARROW.addEventListener("change", () => NARROW.matches && store.set({ rightOpen: false }));
addEventListener("keydown", onKey);
addEventListener("click", () => store.values.menu && store.set({ menu: "" }));
connect();
plotFromAddress(address.getAll("plot"));
const place = document.createElement("div");
place.id = "slidectl";
document.body.append(place);
render(html`<${App} />`, place);
