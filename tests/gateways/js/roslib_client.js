// roslibjs against a running gateway: node roslib_client.js URL MODULE, where MODULE is roslib (2) or roslib-1 (1).
import assert from "node:assert/strict";
import { createRequire } from "node:module";

const [url, name] = process.argv.slice(2);
const ROSLIB = name === "roslib" ? await import("roslib") : createRequire(import.meta.url)("roslib-1");
const isNew = name === "roslib";
const message = (values) => (isNew ? values : new ROSLIB.Message(values));
const asked = (values) => (isNew ? values : new ROSLIB.ServiceRequest(values));

function connected(address) {
  const ros = new ROSLIB.Ros({ url: address });
  return new Promise((resolve, reject) => {
    ros.on("connection", () => resolve(ros));
    ros.on("error", reject);
  });
}

const ros = await connected(url);
const promised = (act) => new Promise((resolve, reject) => act(resolve, reject));
const call = (on, service, type, values) =>
  promised((done, failed) =>
    new ROSLIB.Service({ ros: on, name: service, serviceType: type }).callService(asked(values), done, failed),
  );

// what there is
assert((await promised((done) => ros.getTopics(done))).topics.includes("/slider/joint_states"));
assert((await promised((done) => ros.getServices(done))).includes("/slider/controller_manager/list_controllers"));
assert((await promised((done) => ros.getNodes(done))).includes("/gazebo"));
assert((await promised((done) => ros.getActionServers(done))).some((one) => one.endsWith("/gripper_cmd")));
assert.equal(await promised((done) => ros.getTopicType("/slider/joint_states", done)), "sensor_msgs/JointState");
const details = await promised((done) => ros.getMessageDetails("sensor_msgs/JointState", done));
assert.equal(ros.decodeTypeDefs(details).header.frame_id, "string");

// topics, in all compressions
const options = { ros, name: "/slider/joint_states", messageType: "sensor_msgs/JointState" };
async function first(compression, condition = () => true) {
  const topic = new ROSLIB.Topic({ ...options, compression, throttle_rate: 20, queue_length: 1 });
  const found = await promised((done) => topic.subscribe((one) => condition(one) && done(one)));
  topic.unsubscribe();
  await call(ros, "/rosapi/get_time", "rosapi/GetTime", {}); // nothing of it is under way any more
  return found;
}
for (const [compression, kind] of [["none", Array], ["png", Array], ["cbor", Float64Array]]) {
  const state = await first(compression, (one) => one.position instanceof kind);
  assert.deepEqual(state.name, ["joint1"], compression);
  assert.equal(typeof state.position[0], "number");
}
const raw = await first("cbor-raw", (one) => "bytes" in one);
assert(raw.bytes.length > 60 && raw.secs >= 0);

// a command moves the block
const command = new ROSLIB.Topic({
  ros, name: "/slider/joint1_position_controller/command", messageType: "std_msgs/Float64",
});
command.advertise();
command.publish(message({ data: 1.0 }));
await first("none", (state) => state.position[0] > 0.2);
command.unadvertise();

// services, ours and theirs, done and failed
const listed = await call(ros, "/slider/controller_manager/list_controllers", "controller_manager_msgs/ListControllers", {});
assert.equal(listed.controller.length, 2);
await assert.rejects(call(ros, "/no/such/service", "std_srvs/Empty", {}).catch((text) => { throw new Error(text); }), /such/);
const served = new ROSLIB.Service({ ros, name: `/js_${name.replace("-", "_")}`, serviceType: "std_srvs/SetBool" });
served.advertise((request, response) => {
  response.success = request.data;
  response.message = "from a browser";
  return true;
});
const other = await connected(url);
await call(ros, "/rosapi/get_time", "rosapi/GetTime", {}); // what was sent before has been taken in
assert.equal((await call(other, served.name, "std_srvs/SetBool", { data: true })).message, "from a browser");
other.close();

// parameters
const param = new ROSLIB.Param({ ros, name: "/js/list" });
await promised((done) => param.set([1, "two", 3.5], done));
assert.deepEqual(await promised((done) => param.get(done)), [1, "two", 3.5]);
await promised((done) => param.delete(done));
const gain = new ROSLIB.Param({ ros, name: "/slider/joint1_position_controller/pid/p" });
assert.equal(typeof (await promised((done) => gain.get(done))), "number");

// actions by their topics, and the time-out when nobody serves
const gripper = (await promised((done) => ros.getActionServers(done))).find((one) => one.endsWith("/gripper_cmd"));
const actionName = "control_msgs/GripperCommandAction";
const client = new ROSLIB.ActionClient({ ros, serverName: gripper, actionName });
const goal = new ROSLIB.Goal({
  actionClient: client, goalMessage: { command: { position: 0.05, max_effort: 20 } },
});
const result = promised((done) => goal.on("result", done));
goal.send();
assert.equal(typeof (await result).reached_goal, "boolean");
const nobody = new ROSLIB.ActionClient({ ros, serverName: "/nobody", actionName, timeout: 200 });
await promised((done) => nobody.on("timeout", done));
client.dispose();

if (isNew) {
  // the ops of actions, which only this version has
  const action = new ROSLIB.Action({ ros, name: gripper, actionType: "control_msgs/action/GripperCommand" });
  const moved = await promised((done, failed) =>
    action.sendGoal({ command: { position: 0.01, max_effort: 20 } }, done, () => {}, failed),
  );
  assert.equal(typeof moved.reached_goal, "boolean");
  const refused = await promised((done, failed) =>
    action.sendGoal({ command: "nonsense" }, failed, () => {}, done),
  );
  assert.match(refused, /command/);
  const none = new ROSLIB.Action({ ros, name: "/nobody", actionType: "" });
  assert.match(await promised((done, failed) => none.sendGoal({}, failed, () => {}, done)), /gripper_cmd/);
}

ros.close();
console.log("done");
process.exit(0);
