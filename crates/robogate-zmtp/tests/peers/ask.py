"""Send requests to the given address with libzmq REQ and DEALER sockets. The replies must have the frames in reverse."""

import sys

import zmq

context = zmq.Context()
for kind, envelope in ((zmq.REQ, []), (zmq.DEALER, [b""])):
    socket = context.socket(kind)
    socket.setsockopt(zmq.RCVTIMEO, 10_000)
    socket.setsockopt(zmq.HEARTBEAT_IVL, 20)
    socket.connect(sys.argv[1])
    for frames in ([b"one"], [b"", b"x" * 255, b"y" * 256], [bytes(200_000), b"end"]):
        socket.send_multipart(envelope + frames)
        assert socket.recv_multipart() == envelope + frames[::-1], frames
print("all answered")
