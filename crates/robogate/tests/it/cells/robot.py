"""A robot and an operator's screen that use roslibpy: publishes cycles, then waits for a diagnostic message and prints it.

Usage: robot.py HOST PORT GOOD BAD
"""

import json
import sys
import threading

import roslibpy

host, port, good, bad = sys.argv[1], *map(int, sys.argv[2:])
ros = roslibpy.Ros(host=host, port=port)
ros.run()
alarm, arrived = [], threading.Event()


def on_diagnostics(message):
    alarm.append(message)
    arrived.set()


roslibpy.Topic(ros, "/diagnostics", "diagnostic_msgs/DiagnosticArray").subscribe(on_diagnostics)
scale = roslibpy.Topic(ros, "/scale", "std_msgs/Float64")
result = roslibpy.Topic(ros, "/cell/result", "cell_msgs/Result")
scale.advertise()
result.advertise()
for i in range(good + bad):
    scale.publish(roslibpy.Message({"data": 0.3 + 0.001 * (i % 7)}))
    stamp = {"sec": 1795254000 + 4 * i, "nanosec": 0}
    status = "ok" if i < good else "jammed"
    result.publish(roslibpy.Message({"header": {"stamp": stamp, "frame_id": ""}, "serial": i, "status": status, "duration": 3.5}))
if not arrived.wait(60):
    sys.exit("no diagnostic message within 60 s")
print(json.dumps(alarm[0]))
ros.terminate()
