"""A libzmq REP socket that returns each message with its frames in reverse. Prints its address first."""

import zmq

socket = zmq.Context().socket(zmq.REP)
socket.setsockopt(zmq.HEARTBEAT_IVL, 50)
socket.bind("tcp://127.0.0.1:*")
print(socket.getsockopt(zmq.LAST_ENDPOINT).decode().rstrip("\0"), flush=True)
while True:
    socket.send_multipart(socket.recv_multipart()[::-1])
