"""OpenVLA's vla-scripts/deploy.py, with a stub for the model of transformers: CHECKOUT PORT FOLDER SETTINGS."""

import runpy
import sys

import absent
import model
import numpy as np

checkout, port, stub, options = model.from_arguments(sys.argv[1:])


class Inputs(dict):
    def to(self, *_, **__):
        return self


class Processor:
    @classmethod
    def from_pretrained(cls, *_, **__):
        return cls()

    def __call__(self, prompt, image):
        return Inputs(prompt=prompt, image=np.asarray(image))


class Network:
    @classmethod
    def from_pretrained(cls, *_, **__):
        return cls()

    def to(self, *_, **__):
        return self

    def predict_action(self, prompt, image, unnorm_key, do_sample):
        # The server writes the instruction into a prompt.
        head, tail = "In: What action should the robot take to ", "?\nOut:"
        assert prompt.startswith(head) and prompt.endswith(tail), prompt
        assert unnorm_key == options["unnorm_key"], unnorm_key
        return stub.infer({"image": image}, {}, prompt.removeprefix(head).removesuffix(tail))[0]


absent.without("torch")
absent.module("transformers", AutoModelForVision2Seq=Network, AutoProcessor=Processor)
sys.argv = ["deploy.py", "--openvla_path", "stub", "--host", "127.0.0.1", "--port", str(port)]
runpy.run_path(str(checkout / "vla-scripts/deploy.py"), run_name="__main__")
