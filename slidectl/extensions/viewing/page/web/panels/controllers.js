// One robot: its controllers with their gains, its joints, and what drives it.

import { Drive } from "./drive.js";
import { Gains } from "./gains.js";
import { Joints } from "./joints.js";
import { Trajectories } from "./trajectories.js";
import {
  act, Act, ask, baseName, Button, call, Chip, download, Empty, Group, html, inParts, isUnder, join, notify, page, RUNNING, Select, store,
  useEffect, useState, useStore,
} from "../parts.js";

const STRICT = 2;
const STARTED = [...RUNNING, "waiting"];

/** Call a service of the controller manager; the warnings of a success are shown. */
async function manage(space, verb, args) {
  const { values, reasons } = await ask(join(space, `controller_manager/${verb}`), args);
  const text = reasons.join("\n");
  if (!values.ok) throw Object.assign(new Error(reasons[0] ?? `${verb} was refused`), { hint: reasons.slice(1).join("\n") });
  if (text) notify(reasons[0], reasons.slice(1).join("\n"), "warning");
}

const change = (space, start, stop) => manage(space, "switch_controller", {
  start_controllers: start, stop_controllers: stop, strictness: STRICT, start_asap: false, timeout: 0,
});

async function start(space, names, stop = []) {
  const { controller: before } = await call(join(space, "controller_manager/list_controllers"));
  for (const one of before.filter((each) => names.includes(each.name) && each.state === "unconfigured")) {
    await manage(space, "configure_controller", { name: one.name });
  }
  await change(space, names, stop);
  const { controller } = await call(join(space, "controller_manager/list_controllers"));
  const failed = controller.filter((one) => names.includes(one.name) && !STARTED.includes(one.state));
  if (failed.length) {
    throw Object.assign(new Error(`did not start: ${failed.map((one) => `${one.name} is ${one.state}`).join(", ")}`),
      { hint: "The log says why." });
  }
}

/** What the joints of a stopped controller do. */
function leftAlone({ kind, joints }) {
  const what = { EffortJointInterface: "effort", VelocityJointInterface: "velocity", PositionJointInterface: "position" }[kind] ?? "command";
  return joints.length === 1 ? `${joints[0]} keeps its last ${what}` : `${joints.join(", ")} keep their last ${what}`;
}

function claims(one) {
  return one.claimed_resources.filter((claim) => claim.resources.length)
    .map((claim) => ({ kind: claim.hardware_interface.split("::").pop(), joints: claim.resources }));
}

function Stop({ robot, one, onDone }) {
  const taken = claims(one);
  const space = robot.namespace;
  const rest = (command) => async () => {
    const request = { robot: robot.name, controllers: [one.name], command, left_to: [] };
    await call("/slidectl/rest_joints", { ...request, check_only: true });
    await change(space, [], [one.name]);
    await call("/slidectl/rest_joints", request);
    onDone();
  };
  const plain = async () => {
    await change(space, [], [one.name]);
    onDone();
  };
  const holds = taken.some((claim) => claim.kind !== "EffortJointInterface");
  return html`<div class="behind">
    ${taken.map((claim) => html`<p class="hint">${leftAlone(claim)} when this controller stops.</p>`)}
    <div class="line"><${Act} onClick=${plain}>Stop<//>
      ${taken.length > 0 && html`<${Act} title="Efforts and velocities of 0" onClick=${rest("zero")}>Stop and zero<//>`}
      ${holds && html`<${Act} title="Velocities of 0, positions where the joints are" onClick=${rest("hold")}>Stop and hold<//>`}
      <${Button} onClick=${onDone}>Cancel<//></div>
  </div>`;
}

function Controller({ robot, name, one, type, gains }) {
  const [behind, setBehind] = useState("");
  const readOnly = useStore((s) => s.readOnly);
  const space = robot.namespace;
  const state = one?.state ?? "unloaded";
  const isStarted = STARTED.includes(state);
  const kind = one?.type ?? type;
  const turn = (what) => setBehind(behind === what ? "" : what);
  const joints = one ? claims(one).map((claim) => `${claim.kind}: ${claim.joints.join(" ")}`).join("; ") : "";
  const stop = () => (one && claims(one).length ? turn("stop") : act(() => change(space, [], [name])));
  return html`<div class="controller">
    <div class="row"><span class="name whole" title=${[name, kind, joints].filter(Boolean).join("\n")}>${inParts(name)}</span>
      <${Chip} state=${state} />
      ${isStarted
        ? html`<${Button} disabled=${readOnly} aria-expanded=${behind === "stop"} aria-label=${`Stop ${name}`} onClick=${stop}>Stop<//>`
        : html`<${Act} aria-label=${`Start ${name}`} onClick=${async () => {
            if (!one) await manage(space, "load_controller", { name });
            await start(space, [name]);
          }}>Start<//>`}
      <${Button} icon="more" title=${`More of ${name}`} aria-expanded=${behind === "more"} onClick=${() => turn("more")} />
    </div>
    ${behind === "stop" && isStarted && html`<${Stop} robot=${robot} one=${one} onDone=${() => setBehind("")} />`}
    ${behind === "more" && html`<div class="behind">
      <p class="hint">${inParts(kind)}${joints && html`<br />${joints}`}</p>
      <div class="line">
        ${!one && html`<${Act} onClick=${() => manage(space, "load_controller", { name })}>Load<//>`}
        ${one && html`<${Act} title="Unload and load again, with its present parameters" onClick=${() => reload(robot, one)}>Reload<//>`}
        ${one && !isStarted && html`<${Act} onClick=${() => manage(space, "unload_controller", { name })}>Unload<//>`}
      </div>
      ${gains.map((server) => html`<${Gains} key=${server} space=${space} server=${server} />`)}
      ${one && !gains.length && html`<p class="hint">No gains to change while it runs.</p>`}
    </div>`}
  </div>`;
}

async function reload(robot, one) {
  const space = robot.namespace;
  const wasStarted = STARTED.includes(one.state);
  if (wasStarted) await change(space, [], [one.name]);
  await manage(space, "unload_controller", { name: one.name });
  await manage(space, "load_controller", { name: one.name });
  if (wasStarted) await start(space, [one.name]);
  notify(`${one.name} reloaded`, "", "good");
}

function Switch({ robot, loaded }) {
  const [stop, setStop] = useState("");
  const [begin, setBegin] = useState("");
  const running = loaded.filter((one) => STARTED.includes(one.state)).map((one) => one.name);
  const idle = loaded.filter((one) => !STARTED.includes(one.state)).map((one) => one.name);
  const doSwitch = async () => {
    const [from, to] = [running.includes(stop) ? [stop] : [], idle.includes(begin) ? [begin] : []];
    if (!from.length && !to.length) throw Object.assign(new Error("nothing to switch"), { hint: "Choose what to stop, what to start, or both." });
    if (to.length) await start(robot.namespace, to, from);
    else await change(robot.namespace, to, from);
  };
  return html`<details><summary>Switch in one cycle</summary>
    <div class="line"><${Select} label="Stop" value=${stop} options=${[["", "Stop nothing"], ...running.map((one) => [one, `Stop ${one}`])]} onChange=${setStop} />
    <${Select} label="Start" value=${begin} options=${[["", "Start nothing"], ...idle.map((one) => [one, `Start ${one}`])]} onChange=${setBegin} />
    <${Act} onClick=${doSwitch}>Switch<//></div></details>`;
}

/** Controllers with a `type` parameter in a namespace, loaded or not: name -> type. */
async function configuredIn(space) {
  const prefix = space === "/" ? "/" : `${space}/`;
  const { names } = await call("/rosapi/get_param_names");
  const found = names.filter((one) => one.startsWith(prefix) && one.endsWith("/type")).map((one) => one.slice(prefix.length, -5));
  const plain = found.filter((one) => !one.includes("/"));
  const grouped = found.filter((one) => one.split("/").length === 2 && !plain.includes(one.split("/")[0]));
  const chosen = space === "/" ? plain : [...plain, ...grouped];
  const types = await Promise.all(chosen.map((one) => call("/rosapi/get_param", { name: `${prefix}${one}/type`, default: '""' })));
  return Object.fromEntries(chosen.map((one, place) => [one, String(JSON.parse(types[place].value))]));
}

function Controllers({ robot }) {
  const loaded = useStore((s) => s.controllers[robot.namespace]) ?? [];
  const services = useStore((s) => s.services);
  const [configured, setConfigured] = useState({});
  useEffect(() => {
    let ended = false;
    const read = () => configuredIn(robot.namespace).then((found) => ended || setConfigured(found)).catch(() => {});
    read();
    const end = store.values.ros.subscribe("/slidectl/parameter_changes", read, { type: "slidectl/ParameterChanges", throttle: 500 });
    return () => {
      ended = true;
      end();
    };
  }, [robot.namespace]);
  const byName = Object.fromEntries(loaded.map((one) => [one.name, one]));
  const names = [...loaded.map((one) => one.name), ...Object.keys(configured).filter((one) => !(one in byName))];
  const servers = Object.values(services).filter((one) => one.type === "dynamic_reconfigure/Reconfigure")
    .map((one) => one.name.slice(0, one.name.lastIndexOf("/")));
  const save = () => act(async () => {
    const { file, text } = await page("gains_file", { namespace: robot.namespace });
    download(file, text, "application/yaml");
  });
  const aside = names.length ? html`<${Button} title="A file for spawn --controllers" onClick=${save}>Save YAML<//>` : null;
  return html`<${Group} title="Controllers" aside=${aside}>
    ${names.map((name) => html`<${Controller} key=${name} robot=${robot} name=${name} one=${byName[name]} type=${configured[name]}
      gains=${servers.filter((one) => isUnder(one, join(robot.namespace, name)))} />`)}
    ${loaded.length > 1 && html`<${Switch} robot=${robot} loaded=${loaded} />`}
    ${!names.length && html`<${Empty}>No controllers yet: <code>slidectl controller config FILE.yaml</code><//>`}
  <//>`;
}

function Estop({ robot }) {
  const set = (stop) => () => call("/slidectl/estop", { names: [robot.name], stop });
  return robot.estop
    ? html`<${Act} onClick=${set(false)}>Release the stop<//>`
    : html`<${Act} kind="danger" title="Emergency stop: efforts and velocities of 0 from the next cycle on" onClick=${set(true)}>Stop all<//>`;
}

function Panel() {
  const robots = useStore((s) => s.robots);
  const wanted = useStore((s) => s.robot);
  const moving = robots.filter((one) => one.joints.some((joint) => joint.position !== null) || one.kind === "robot");
  const robot = moving.find((one) => one.name === wanted) ?? moving[0];
  useEffect(() => {
    if (robot && !wanted) store.set({ robot: robot.name }); // when it has gone, the panel says so
  }, [robot?.name, wanted]);
  if (!robot) {
    return html`<${Empty}>${robots.length ? "No robot with joints." : "The world is empty."} <code>slidectl spawn slider</code><//>`;
  }
  const choose = (name) => {
    store.set({ robot: name });
    const query = new URLSearchParams(location.search);
    query.set("robot", name);
    history.replaceState(null, "", `?${query}`);
  };
  return html`
    <header class="robot">
      ${moving.length > 1
        ? html`<${Select} label="Robot" value=${robot.name} options=${moving.map((one) => one.name)} onChange=${choose} />`
        : html`<h1 title=${robot.namespace}>${robot.name}</h1>`}
      ${robot.kind === "robot" && html`<${Estop} robot=${robot} />`}
    </header>
    ${wanted && wanted !== robot.name && html`<p class="hint" role="status">There is no robot ${wanted} with joints: this is ${robot.name}.</p>`}
    <${Drive} key=${`d${robot.name}`} robot=${robot} />
    ${robot.kind === "robot" && html`<${Controllers} key=${`c${robot.name}`} robot=${robot} />`}
    <${Joints} key=${`j${robot.name}`} robot=${robot} />
    <${Trajectories} key=${`t${robot.name}`} robot=${robot} />`;
}

export const controllersPanel = { title: "Robot", Panel };
