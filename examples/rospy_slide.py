#!/usr/bin/python3
"""A rospy node moves the block of the slider: by its topic, in simulated time, and the arm by an action if it is there.

    slidectl daemon start --ros1
    slidectl spawn slider --controllers config/slider_control.yaml
    slidectl controller spawn joint_state_controller joint1_position_controller
    export ROS_MASTER_URI=http://localhost:11311
    python3 examples/rospy_slide.py

It knows nothing of slidectl: with Gazebo and ros_control it does the same.
"""

import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

TOLERANCE_M = 0.02
LIMIT = rospy.Duration(300.0)


class Block:
    """Where the block is, and the way to send it elsewhere."""

    def __init__(self):
        self.position = 0.0
        self._command = rospy.Publisher("/slider/joint1_position_controller/command", Float64, queue_size=1)
        rospy.Subscriber("/slider/joint_states", JointState, self._take)
        while self._command.get_num_connections() == 0:
            rospy.rostime.wallsleep(0.01)

    def _take(self, state):
        self.position = state.position[0]

    def slide(self, target):
        """Send it there and wait until it has come, at most 300 simulated seconds."""
        start = rospy.Time.now()
        self._command.publish(target)
        while abs(self.position - target) > TOLERANCE_M:
            if rospy.Time.now() - start > LIMIT:
                raise SystemExit(f"the block did not come to {target} m, it is at {self.position:.3f} m")
            rospy.sleep(0.02)
        print(f"{target:+.1f} m: there after {(rospy.Time.now() - start).to_sec():.2f} simulated seconds")


def reach(positions):
    """Send the arm there by its action, where there is an arm, and where ROS has control_msgs."""
    try:
        import actionlib
        from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
        from trajectory_msgs.msg import JointTrajectoryPoint
    except ImportError as error:
        print(f"the arm stays where it is: {error}")
        return
    client = actionlib.SimpleActionClient("/arm/arm_controller/follow_joint_trajectory", FollowJointTrajectoryAction)
    if not client.wait_for_server(rospy.Duration(5.0)):
        print("there is no arm")
        return
    goal = FollowJointTrajectoryGoal()
    goal.trajectory.joint_names = [f"joint{number}" for number in range(1, 7)]
    goal.trajectory.points = [JointTrajectoryPoint(positions=positions, time_from_start=rospy.Duration(2.0))]
    client.send_goal_and_wait(goal)
    if client.get_state() != actionlib.GoalStatus.SUCCEEDED:
        raise SystemExit(f"the arm did not get there: {client.get_goal_status_text()}")
    print("the arm is there")


def main():
    rospy.init_node("rospy_slide")
    block = Block()
    for target in (0.4, -0.2):
        block.slide(target)
    reach([0.5, 0.2, 0.4, 0.0, 0.3, 0.0])


main()
