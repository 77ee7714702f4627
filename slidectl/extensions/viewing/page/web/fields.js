// Fields of messages: their paths (`position[0]`, `wrench/force/x`), their units, and their values in a message.

import { call, jointUnit, join, store } from "./parts.js";

const UNITS = {
  "geometry_msgs/Twist": { linear: "m/s", angular: "rad/s" },
  "geometry_msgs/Accel": { linear: "m/s²", angular: "rad/s²" },
  "geometry_msgs/Wrench": { force: "N", torque: "N·m" },
  "geometry_msgs/Pose": { position: "m" },
  "geometry_msgs/PointStamped": { point: "m" },
  "geometry_msgs/Pose2D": { x: "m", y: "m", theta: "rad" },
  "geometry_msgs/Transform": { translation: "m" },
  "sensor_msgs/Imu": { angular_velocity: "rad/s", linear_acceleration: "m/s²" },
  "sensor_msgs/LaserScan": {
    angle_min: "rad", angle_max: "rad", angle_increment: "rad", scan_time: "s", time_increment: "s", range_min: "m",
    range_max: "m", ranges: "m",
  },
  "sensor_msgs/Range": { field_of_view: "rad", min_range: "m", max_range: "m", range: "m" },
  "rosgraph_msgs/Clock": { clock: "s" },
  "std_msgs/Header": { stamp: "s" },
  "control_msgs/JointControllerState": { time_step: "s" },
};
const JOINT_STATE = "sensor_msgs/JointState";
const QUANTITIES = ["position", "velocity", "effort"];
const POINT_QUANTITIES = { positions: "position", velocities: "velocity", accelerations: "acceleration", effort: "effort" };
const RATES = { position: "velocity", velocity: "acceleration" };
const NUMBERS = new Set([
  "bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64",
  "time", "duration",
]);
const details = new Map();

/** Type -> [{name, type, array}] for a message type and all types in it; `array` is -1 for a single value. */
export function typesOf(kind) {
  if (!details.has(kind)) {
    const found = call("/rosapi/message_details", { type: kind }).then((answer) => parsed(answer.typedefs));
    found.catch(() => details.delete(kind));
    details.set(kind, found);
  }
  return details.get(kind);
}

export const parsed = (typedefs) => Object.fromEntries(typedefs.map((one) => [one.type, one.fieldnames.map((name, place) =>
  ({ name, type: one.fieldtypes[place], array: one.fieldarraylen[place] }))]));

export const isNumber = (type) => NUMBERS.has(type);
export const isTime = (type) => type === "time" || type === "duration";

/** The steps of a path: names, and indices as numbers or slices {begin, end, step}, as in Python. Throws an Error that says what is wrong. */
export function steps(path) {
  const found = [];
  for (const part of path.split(/[/.]/).filter(Boolean)) {
    const match = /^([A-Za-z]\w*)((?:\[[^\]]*\])*)$/.exec(part);
    if (!match) throw new Error(`${part} is not a field: write NAME or NAME[0]`);
    found.push(match[1]);
    for (const [, inside] of match[2].matchAll(/\[([^\]]*)\]/g)) {
      const bounds = inside.split(":").map((text) => text.trim());
      const isIndex = bounds.length <= 3 && bounds.every((text) => /^-?\d+$/.test(text) || (!text && bounds.length > 1));
      if (Number(bounds[2] || 1) === 0) throw new Error(`[${inside}] is not an index: the step of a slice cannot be 0`);
      if (!isIndex) throw new Error(`[${inside}] is not an index: write [0], [-1], [1:3] or [::2]`);
      const [begin, end] = bounds.map((text) => (text ? Number(text) : null));
      found.push(bounds.length === 1 ? begin : { begin, end, step: Number(bounds[2] || 1) });
    }
  }
  return found;
}

/** The number of a value: of times in s; NaN for what is none. */
export function numeric(value) {
  if (typeof value === "number") return value;
  if (typeof value === "boolean") return Number(value);
  if (value && typeof value === "object" && "secs" in value) return value.secs + value.nsecs / 1e9;
  return NaN;
}

/** The elements of a slice. Negative places count from the end; a negative step goes backwards. */
function sliced(array, { begin, end, step }) {
  const [low, high] = step > 0 ? [0, array.length] : [-1, array.length - 1];
  const placeOf = (given) => Math.min(Math.max(given < 0 ? given + array.length : given, low), high);
  const first = begin === null ? (step > 0 ? low : high) : placeOf(begin);
  const last = end === null ? (step > 0 ? high : low) : placeOf(end);
  const found = [];
  for (let place = first; step > 0 ? place < last : place > last; place += step) found.push(array[place]);
  return found;
}

/** What is in a message at the steps of a path, of each element where a field of a list is meant; undefined for nothing. */
export function valueAt(message, path) {
  let value = message;
  for (const [place, one] of path.entries()) {
    if (value === undefined || value === null) return undefined;
    if (typeof one === "string") {
      if (Array.isArray(value)) return value.map((each) => valueAt(each, path.slice(place)));
      value = value[one];
    } else {
      if (!Array.isArray(value)) return undefined;
      value = typeof one === "number" ? value.at(one) : sliced(value, one);
    }
  }
  return value;
}

/** [path, number] for all numbers in the value at a path: itself, or those inside. */
export function* numbersIn(value, path, most = 32) {
  if (value === null || typeof value === "number" || typeof value === "boolean" || (value && typeof value === "object" && "secs" in value)) {
    yield [path, numeric(value)];
  } else if (Array.isArray(value)) {
    for (let place = 0; place < Math.min(value.length, most); place++) yield* numbersIn(value[place], `${path}[${place}]`, most);
  } else if (value && typeof value === "object") {
    for (const [name, inner] of Object.entries(value)) {
      if (name !== "header") yield* numbersIn(inner, path ? `${path}/${name}` : name, most);
    }
  }
}

const controllerKinds = new Map();

function kindOf(space) {
  if (!controllerKinds.has(space)) {
    controllerKinds.set(space, { type: "", joint: "" });
    const get = (name) => call("/rosapi/get_param", { name: `${space}/${name}`, default: '""' }).then(({ value }) => String(JSON.parse(value)));
    Promise.all([get("type"), get("joint")]).then(([type, joint]) => controllerKinds.set(space, { type, joint })).catch(() => {});
  }
  return controllerKinds.get(space);
}

/** Have the units of a topic's controller ready. */
export async function prepareUnits(topic) {
  const space = topic.slice(0, topic.lastIndexOf("/"));
  kindOf(space);
  for (let turn = 0; turn < 20 && !kindOf(space).type; turn++) await new Promise((resolve) => setTimeout(resolve, 20));
}

const jointNamed = (name, space) => store.values.robots.flatMap((robot) => robot.joints.map((joint) => [join(robot.namespace, joint.name), joint]))
  .find(([full]) => full === join(space, name))?.[1];

/** The unit of a field of a topic's messages; empty when it is not known. `about` is the joint that the value is of. */
export function unitOf(topic, types, root, path, about = "") {
  let [unit, kind] = ["", root];
  for (const name of steps(path).filter((one) => typeof one === "string")) {
    unit = UNITS[kind]?.[name] ?? unit;
    kind = types[kind]?.find((field) => field.name === name)?.type ?? "";
  }
  if (unit || isTime(kind)) return unit || "s";
  const space = topic.slice(0, topic.lastIndexOf("/"));
  const first = path.split(/[/.[]/)[0];
  if (root === JOINT_STATE && QUANTITIES.includes(first)) {
    const joint = jointNamed(about, space);
    return joint ? jointUnit(joint, first) : "";
  }
  const above = space.slice(0, space.lastIndexOf("/")) || "/";
  if (root === "control_msgs/JointTrajectoryControllerState") {
    const joint = jointNamed(about, above);
    return joint ? jointUnit(joint, POINT_QUANTITIES[steps(path)[1]]) : "";
  }
  if (root !== "control_msgs/JointControllerState" && root !== "std_msgs/Float64") return "";
  const { type, joint: name } = kindOf(space);
  const taken = /^(effort|velocity|position)_controllers\/Joint(Position|Velocity|Effort)Controller$/.exec(type);
  if (!taken) return "";
  const joint = jointNamed(name, above);
  const controlled = taken[2].toLowerCase();
  if (["set_point", "process_value", "error", "data"].includes(path)) return jointUnit(joint, controlled);
  if (path === "process_value_dot") return jointUnit(joint, RATES[controlled]);
  return path === "command" ? jointUnit(joint, taken[1]) : "";
}

/** The name of what an element of an array is of: that of a joint, where the message has as many names. */
export function nameOfElement(message, path) {
  const names = message?.name ?? message?.joint_names;
  const all = steps(path);
  const indices = all.slice(all.findLastIndex((one) => typeof one === "string") + 1);
  if (!Array.isArray(names) || !indices.length) return "";
  const name = valueAt(names, indices);
  return typeof name === "string" ? name : "";
}

/** `state/{a,b}` as `state/a` and `state/b`, as a shell does. */
export function expanded(text) {
  const match = /\{([^{}]*,[^{}]*)\}/.exec(text);
  if (!match) return [text];
  return match[1].split(",").flatMap((part) => expanded(text.slice(0, match.index) + part + text.slice(match.index + match[0].length)));
}

/** The topic and the field that a text means: {topic, path, type, types}. Rejects with what is wrong with it. */
export async function resolve(text) {
  const { robots, robot } = store.values;
  const namespace = (robots.find((one) => one.name === robot) ?? robots[0])?.namespace ?? "/";
  const answer = await call("/slidectl/resolve", { kind: "topic", name: text, namespace, role: "publishers", with_field: true });
  const types = parsed(answer.typedefs);
  let kind = answer.type;
  for (const name of steps(answer.field).filter((one) => typeof one === "string")) {
    const field = types[kind]?.find((one) => one.name === name);
    if (!field) {
      const known = (types[kind] ?? []).map((one) => one.name).join(", ");
      throw Object.assign(new Error(`${kind} has no field ${name}`), { hint: known && `fields: ${known}` });
    }
    kind = field.type;
  }
  if (kind === "string") throw Object.assign(new Error(`${answer.field} of ${answer.type} is string, which is not a number`), { hint: "" });
  await prepareUnits(answer.name);
  return { topic: answer.name, path: answer.field, type: answer.type, types };
}
