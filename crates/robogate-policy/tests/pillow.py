"""Write pillow.txt: hashes of the image in src/picture.rs after resizing with Pillow (pillow==13.0.0)."""

import PIL
from PIL import Image

WIDTH, HEIGHT = 13, 9


def fnv(data: bytes) -> int:
    h = 0xCBF29CE484222325
    for b in data:
        h = ((h ^ b) * 0x100000001B3) % 2**64
    return h


def padded(image: Image.Image, width: int, height: int) -> Image.Image:
    """The steps of openpi-client's resize_with_pad."""
    ratio = max(image.width / width, image.height / height)
    inner = image.resize((int(image.width / ratio), int(image.height / ratio)), Image.BILINEAR)
    out = Image.new("RGB", (width, height), 0)
    out.paste(inner, ((width - inner.width) // 2, (height - inner.height) // 2))
    return out


pixels = bytes((i * i * 7 + i * 31) % 256 for i in range(3 * WIDTH * HEIGHT))
image = Image.frombytes("RGB", (WIDTH, HEIGHT), pixels)
print(f"# Pillow {PIL.__version__}; python tests/pillow.py > tests/pillow.txt")
for width, height in [(8, 5), (26, 20), (13, 4)]:
    print("bilinear", width, height, fnv(image.resize((width, height), Image.BILINEAR).tobytes()))
    print("lanczos", width, height, fnv(image.resize((width, height), Image.LANCZOS).tobytes()))
for width, height in [(8, 8), (20, 30)]:
    print("pad", width, height, fnv(padded(image, width, height).tobytes()))
