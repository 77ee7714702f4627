// The joints of a robot: where they are, and a slider for each command topic of a running controller.

import {
  attempt, Button, call, Group, html, join, jointUnit, notify, number, RUNNING, store, Typed, useEffect, useEvery, useRef, useState,
  useStore, useTopic,
} from "../parts.js";

const SCALAR = "std_msgs/Float64";
const ARRAY = "std_msgs/Float64MultiArray";
const MOVING = ["revolute", "continuous", "prismatic"];
const QUANTITIES = ["Position", "Velocity", "Effort"];
const SPANS = { Position: [2 * Math.PI, 1], Velocity: [2 * Math.PI, 1], Effort: [10, 10] };
const SETTLE_MS = 1000;
const SEND_MS = 30;
const JOG_S = 4; // seconds from one end of the range to the other

/** The limits of a joint; null for one without. */
function limitsOf(joint, quantity) {
  let [low, high] = [joint?.lower, joint?.upper];
  if (quantity !== "Position") {
    high = joint?.[`max_${quantity.toLowerCase()}`];
    low = typeof high === "number" ? -high : null;
  }
  if (typeof low === "number" && typeof high === "number" && Number.isFinite(high - low) && low < high) return [low, high];
  return null;
}

/** The range of a slider: the limits of the joint, or a range that suits most. */
export function bounds(joint, quantity) {
  const limits = limitsOf(joint, quantity);
  if (limits) return limits;
  const span = SPANS[quantity][joint?.type === "prismatic" ? 1 : 0];
  return [-span, span];
}

export const stepOf = ([low, high]) => Math.min(0.01, 10 ** Math.floor(Math.log10((high - low) / 1000)));
const cut = (value, [low, high]) => Math.min(Math.max(value, low), high);
const rounded = (value) => Math.round(value * 1e4) / 1e4;
export const placed = (value, range) => cut(rounded(value), range);

function drivesOf(robot, controllers, topics) {
  const found = [];
  for (const one of robot.kind === "robot" ? controllers : []) {
    const topic = join(robot.namespace, `${one.name}/command`);
    const claim = one.claimed_resources.find((each) => each.resources.length);
    const kind = topics[topic]?.type;
    if (!RUNNING.includes(one.state) || !claim || ![SCALAR, ARRAY].includes(kind)) continue;
    const told = [one.type.split("/").pop(), claim.hardware_interface];
    const quantity = told.flatMap((text) => QUANTITIES.filter((word) => text.includes(word)))[0] ?? "Position";
    const joints = kind === SCALAR ? claim.resources.slice(0, 1) : claim.resources;
    found.push({ controller: one.name, topic, quantity, joints, isArray: kind === ARRAY });
  }
  return found;
}

/** The sliders of one controller. They follow what others command, except while one of them is moved. */
function Commands({ robot, drive, names, topics }) {
  const readOnly = useStore((s) => s.readOnly);
  const joints = names.map((name) => robot.joints.find((joint) => joint.name === name));
  const ranges = joints.map((joint) => bounds(joint, drive.quantity));
  // Where a joint has no limits, only its slider ends: other commands may be beyond it.
  const limits = joints.map((joint) => limitsOf(joint, drive.quantity) ?? [-Infinity, Infinity]);
  const [values, setValues] = useState(() => joints.map((joint, place) =>
    placed(drive.quantity === "Position" ? joint?.position ?? 0 : 0, limits[place])));
  const settled = useRef(0);
  const waiting = useRef(null);
  const later = useRef(null);
  const newest = useRef(values);
  useEffect(() => () => clearTimeout(later.current), []);
  const state = `${drive.topic.slice(0, -"/command".length)}/state`;
  const isTold = !drive.isArray && topics[state]?.type === "control_msgs/JointControllerState";
  const follow = (told) => {
    clearTimeout(later.current);
    const wait = settled.current - performance.now();
    if (wait > 0) { // a slider is moved here: what others command counts after that
      later.current = setTimeout(() => follow(told), wait + 1);
      return;
    }
    const now = told.map((value, place) => (Number.isFinite(value) ? value : newest.current[place]));
    if (now.every((value, place) => value === newest.current[place])) return;
    newest.current = now;
    setValues(now);
  };
  useTopic(drive.topic, (msg) => follow(drive.isArray ? msg.data : [msg.data]), { throttle: 200 });
  // The set point now, which may be another one than the last command. One message is enough: the daemon makes a hundred
  // of them a second, as long as somebody subscribes.
  const cycles = useStore((s) => s.status?.cycles ?? 0);
  const before = useRef(0);
  const isReset = cycles < before.current;
  before.current = cycles;
  useEffect(() => {
    if (!isTold) return undefined;
    const end = store.values.ros.subscribe(state, (msg) => {
      follow([msg.set_point]);
      end();
    });
    return end;
  }, [state, isTold, robot.controllers.join(), isReset]);
  const send = (place, value) => {
    const now = newest.current.map((one, at) => (at === place ? cut(value, limits[place]) : one));
    newest.current = now;
    setValues(now);
    settled.current = performance.now() + SETTLE_MS;
    waiting.current ??= setTimeout(() => {
      waiting.current = null;
      const data = drive.isArray ? newest.current : newest.current[0];
      attempt(() => store.values.ros.publish(drive.topic, { data }));
    }, SEND_MS);
  };
  return names.map((name, place) => {
    const unit = jointUnit(joints[place], drive.quantity.toLowerCase());
    const [low, high] = ranges[place];
    const value = values[place] ?? 0;
    const jog = (sign) => (passed) => send(place, rounded(newest.current[place] + (sign * passed * (high - low)) / JOG_S));
    return html`<div class="command" key=${name}>
      <div class="row"><span class="name" title=${`${drive.controller}: ${name}`}>${name}</span>
        <${Jog} icon="back" title=${`Jog ${name} back`} disabled=${readOnly} onMove=${jog(-1)} />
        <${Jog} icon="forth" title=${`Jog ${name} forth`} disabled=${readOnly} onMove=${jog(1)} />
        <${Typed} class="exact" inputmode="decimal" aria-label=${`Command of ${name}, ${unit}`} value=${number(value, 3)}
          disabled=${readOnly} onCommit=${(text) => {
            const typed = text ? Number(text.replace("−", "-").replace(",", ".")) : NaN;
            if (Number.isFinite(typed)) send(place, typed);
            else notify(`${name}: a number is needed`, "", "bad");
          }} /><span class="unit">${unit}</span></div>
      <input type="range" aria-label=${`${drive.controller}, ${name}`} min=${low} max=${high} step=${stepOf(ranges[place])}
        value=${value} style=${{ "--part": `${(100 * (placed(value, ranges[place]) - low)) / (high - low)}%` }}
        disabled=${readOnly} onInput=${(event) => send(place, rounded(Number(event.target.value)))} />
    </div>`;
  });
}

/** A button that moves as long as it is held: `onMove` gets the seconds that have passed. */
function Jog({ onMove, ...rest }) {
  const timer = useRef(null);
  const newest = useRef();
  newest.current = onMove;
  const end = () => {
    clearInterval(timer.current);
    timer.current = null;
  };
  const begin = (event) => {
    event.preventDefault();
    end();
    let last = performance.now();
    timer.current = setInterval(() => {
      const now = performance.now();
      newest.current((now - last) / 1000);
      last = now;
    }, 40);
  };
  useEffect(() => {
    addEventListener("blur", end);
    return () => {
      removeEventListener("blur", end);
      end();
    };
  }, []);
  const onKey = (event) => [" ", "Enter"].includes(event.key) && !event.repeat && begin(event);
  return html`<${Button} kind="jog" ...${rest} onPointerDown=${begin} onPointerUp=${end} onPointerLeave=${end} onPointerCancel=${end}
    onKeyDown=${onKey} onKeyUp=${end} onBlur=${end} />`;
}

function ArrayCommands(props) {
  const [names, setNames] = useState(null);
  useEffect(() => {
    const space = props.drive.topic.slice(0, -"/command".length);
    call("/rosapi/get_param", { name: `${space}/joints`, default: "[]" })
      .then(({ value }) => setNames(JSON.parse(value))).catch(() => setNames(props.drive.joints));
  }, [props.drive.topic]);
  return names && html`<${Commands} ...${props} names=${names} />`;
}

function States({ robot, joints }) {
  const [rows, setRows] = useState({});
  useEvery(200, async () => {
    const answer = await call("/slidectl/joint_states").catch(() => null);
    if (!answer) return;
    const prefix = `${robot.name}::`;
    const found = {};
    answer.joints.forEach((full, place) => {
      if (full.startsWith(prefix)) found[full.slice(prefix.length)] = [answer.position, answer.velocity, answer.effort].map((one) => one[place]);
    });
    setRows((before) => (JSON.stringify(before) === JSON.stringify(found) ? before : found));
  }, robot.name);
  const quantities = ["position", "velocity", "effort"];
  const isMixed = new Set(joints.map((joint) => joint.type === "prismatic")).size > 1;
  return html`<table class="states"><thead><tr><th>Joint</th>${["Position", "Velocity", "Effort"].map((title, place) =>
      html`<th>${title}${!isMixed && html`<br />${jointUnit(joints[0], quantities[place])}`}</th>`)}</tr></thead>
    <tbody>${joints.map((joint) => html`<tr key=${joint.name}><th scope="row" title=${joint.name}>${joint.name}</th>
      ${quantities.map((quantity, place) => html`<td>${number(rows[joint.name]?.[place])}
        ${isMixed && html`<i>${jointUnit(joint, quantity)}</i>`}</td>`)}</tr>`)}</tbody></table>`;
}

export function Joints({ robot }) {
  const controllers = useStore((s) => s.controllers[robot.namespace]) ?? [];
  const topics = useStore((s) => s.topics);
  const joints = robot.joints.filter((joint) => MOVING.includes(joint.type));
  if (!joints.length) return null;
  const drives = drivesOf(robot, controllers, topics);
  return html`${drives.length > 0 && html`<${Group} title="Commands">
      ${drives.map((drive) => drive.isArray
        ? html`<${ArrayCommands} key=${drive.topic} robot=${robot} drive=${drive} topics=${topics} />`
        : html`<${Commands} key=${drive.topic} robot=${robot} drive=${drive} names=${drive.joints} topics=${topics} />`)}
    <//>`}
    <${Group} title="Joints"><${States} robot=${robot} joints=${joints} /><//>`;
}
