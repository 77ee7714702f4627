// Goals for the trajectory controllers of a robot: where the joints are to be, and when.

import {
  act, Act, attempt, call, Field, Group, html, isUnder, jointUnit, number, page, RUNNING, Select, store, useEffect, useMessage, useRef,
  useState, useStore,
} from "../parts.js";
import { bounds, placed, stepOf } from "./joints.js";

const GOAL = "control_msgs/FollowJointTrajectoryActionGoal";
const RESULTS = { 2: "preempted", 3: "succeeded", 4: "aborted", 5: "rejected", 8: "recalled", 9: "lost" };
const GHOST_MS = 1000; // slidectl view removes a ghost that is not shown again within 3 s
let serial = 0;

const time = (seconds) => {
  const nanoseconds = Math.round(seconds * 1e9);
  return { secs: Math.floor(nanoseconds / 1e9), nsecs: nanoseconds % 1e9 };
};

async function desired(controller) {
  const { time: now } = await call("/rosapi/get_time");
  const answer = await call(`${controller}/query_state`, { time: now });
  return Object.fromEntries(answer.name.map((name, place) => [name, answer.position[place]]));
}

function Goal({ robot, controller, action }) {
  const readOnly = useStore((s) => s.readOnly);
  const timestep = useStore((s) => s.status?.timestep) ?? 0.001;
  const [targets, setTargets] = useState(null);
  const [duration, setDuration] = useState("2");
  const [told, setTold] = useState("");
  const [isEdited, setEdited] = useState(false);
  const goal = useRef("");
  const state = useMessage(`${controller}/state`, { throttle: 100 });
  const joints = Object.fromEntries(robot.joints.map((joint) => [joint.name, joint]));
  const ranges = Object.fromEntries(Object.keys(targets ?? {}).map((name) => [name, bounds(joints[name], "Position")]));
  const takePresent = async () => {
    const now = Object.entries(await desired(controller));
    setEdited(false);
    setTargets(Object.fromEntries(now.map(([name, value]) => [name, placed(value, bounds(joints[name], "Position"))])));
  };
  useEffect(() => {
    attempt(takePresent);
    return store.values.ros.subscribe(`${action}/result`, (msg) => {
      if (msg.status.goal_id.id !== goal.current) return;
      const text = msg.status.text || msg.result.error_string;
      if (msg.status.status === 3) setEdited(false);
      setTold([RESULTS[msg.status.status] ?? "ended", text].filter(Boolean).join(": "));
    }, { queue: 10 });
  }, [controller]);
  // The ghost of the goal in the scene, from the first change until the goal is reached.
  useEffect(() => {
    if (!isEdited) return undefined;
    const show = () => document.hidden || page("ghost", { robot: robot.name, positions: targets }).catch(() => {});
    show();
    const timer = setInterval(show, GHOST_MS);
    return () => clearInterval(timer);
  }, [isEdited, targets]);
  useEffect(() => (isEdited ? () => page("ghost", { robot: "" }).catch(() => {}) : undefined), [isEdited]);
  if (!targets) return null;
  const seconds = Number(duration);
  const isGood = duration.trim() !== "" && seconds >= timestep && seconds <= 1e6;
  const send = async () => {
    const names = Object.keys(targets);
    const zeros = names.map(() => 0);
    const point = { positions: names.map((name) => targets[name]), velocities: zeros, accelerations: zeros, time_from_start: time(seconds) };
    goal.current = `page-${Math.random().toString(36).slice(2)}-${++serial}`;
    setTold("active");
    await store.values.ros.publish(`${action}/goal`, {
      goal_id: { id: goal.current }, goal: { trajectory: { joint_names: names, points: [point] } },
    }).catch((error) => {
      setTold("");
      throw error;
    });
  };
  const rows = state?.joint_names.map((name, place) => [name, ...["desired", "actual", "error"].map((which) => state[which].positions[place])]) ?? [];
  return html`
    ${Object.entries(targets).map(([name, value]) => html`<div class="command" key=${name}>
      <div class="row"><span class="name" title=${name}>${name}</span><span class="value">${number(value)} ${jointUnit(joints[name], "position")}</span></div>
      <input type="range" aria-label=${`Goal of ${name}`} min=${ranges[name][0]} max=${ranges[name][1]} step=${stepOf(ranges[name])}
        value=${value} disabled=${readOnly} style=${{ "--part": `${(100 * (value - ranges[name][0])) / (ranges[name][1] - ranges[name][0])}%` }}
        onInput=${(event) => { setTargets({ ...targets, [name]: Number(event.target.value) }); setEdited(true); }} /></div>`)}
    <${Field} label="Duration, s" error=${isGood ? "" : `A number from ${timestep} to 1e6`}>
      <input inputmode="decimal" value=${duration} onInput=${(event) => setDuration(event.target.value)} /><//>
    <div class="line"><${Act} kind="primary" disabled=${!isGood} onClick=${send}>Send<//>
      <${Act} title="Cancel the trajectory and stay in place" onClick=${() => store.values.ros.publish(`${controller}/command`, {})}>Hold<//>
      <${Act} onClick=${() => store.values.ros.publish(`${action}/cancel`, {})}>Cancel goals<//>
      <${Act} title="Goals where the joints are meant to be now" onClick=${takePresent}>Set to the present positions<//></div>
    ${told && html`<p class="hint" role="status">Goal: ${told}</p>`}
    <table class="states"><thead><tr><th>Joint</th><th>Desired</th><th>Actual</th><th>Error</th></tr></thead>
      <tbody>${rows.map(([name, ...values]) => html`<tr key=${name}><th scope="row">${name}</th>${values.map((value) => html`<td>${number(value)}</td>`)}</tr>`)}</tbody></table>`;
}

export function Trajectories({ robot }) {
  const topics = useStore((s) => s.topics);
  const controllers = useStore((s) => s.controllers[robot.namespace]) ?? [];
  const [chosen, setChosen] = useState("");
  const running = controllers.filter((one) => RUNNING.includes(one.state)).map((one) => one.name);
  const found = Object.values(topics).filter((one) => one.type === GOAL && isUnder(one.name, robot.namespace))
    .map((one) => one.name.slice(0, -"/goal".length))
    .filter((action) => running.some((name) => action.slice(0, action.lastIndexOf("/")).endsWith(`/${name}`)));
  if (!found.length) return null;
  const action = found.includes(chosen) ? chosen : found[0];
  const controller = action.slice(0, action.lastIndexOf("/"));
  return html`<${Group} title="Trajectory">
    ${found.length > 1 && html`<${Field} label="Controller"><${Select} label="Controller" value=${action} options=${found.map((one) => [one, one.slice(0, one.lastIndexOf("/"))])} onChange=${setChosen} /><//>`}
    <${Goal} key=${controller} robot=${robot} controller=${controller} action=${action} />
  <//>`;
}
