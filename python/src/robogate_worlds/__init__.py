"""Many worlds of RoboGate's cell at once, with MuJoCo Warp on a GPU or on a CPU.

RoboGate starts this package as a process (`python -m robogate_worlds`). RoboGate compiles each scene with its own MuJoCo
engine and passes the model, so both engines have the same robot, drives and contacts. Requests and replies are lines of
JSON on standard input and output; arrays are in files that both processes map (`tables.py`).
"""
