"""Runs lines of ROS's tools, each in a fork of this process: what is imported once need not be imported by each.

Takes [words, stdin, stdout, stderr] as a line of JSON, where the last three are files; answers with the exit code.
"""

import atexit
import contextlib
import json
import os
import sys
import threading
import traceback

import rosnode
import rosparam
import rospy
import rosservice
import rostopic

MAINS = {
    "rosnode": rosnode.rosnodemain,
    "rosparam": rosparam.yamlmain,
    "rosservice": rosservice.rosservicemain,
    "rostopic": rostopic.rostopicmain,
}


def run(words, *files):
    """As the program of that name does: run it, wait for its threads, call what is registered for the end."""
    for number, (file, flags) in enumerate(zip(files, (os.O_RDONLY, os.O_WRONLY, os.O_WRONLY), strict=True)):
        os.dup2(os.open(file, flags), number)
    sys.argv[:] = [f"/usr/bin/{words[0]}", *words[1:]]  # rosservice has this very list as its default
    rospy.names.reload_mappings(sys.argv)
    code = 0
    try:
        MAINS[words[0]]()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
        code = 1
    threading._shutdown()
    atexit._run_exitfuncs()
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def main():
    for line in sys.stdin:
        words, *files = json.loads(line)
        child = os.fork()
        if child == 0:
            run(words, *files)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


main()
