"""Writes sobol.json: SciPy reference values for the unscrambled Sobol sequence.

    pip install numpy==2.4.6 scipy==1.17.1
    python sobol.py > sobol.json
"""

import json

import numpy
import scipy
from scipy.stats import qmc

assert (numpy.__version__, scipy.__version__) == ("2.4.6", "1.17.1")

DIMENSIONS = 64
# The Gray code of 0xAAAAAA is 24 ones: the point there is the sum of the first 24 direction numbers.
FAR = 0xAAAAAA


def integers(points, bits):
    scaled = points * 2**bits
    assert (scaled == scaled.astype(int)).all()
    return scaled.astype(int).tolist()


def sobol(dimensions):
    return qmc.Sobol(dimensions, scramble=False, bits=30)


near = sobol(DIMENSIONS).random(64)
far = sobol(DIMENSIONS).fast_forward(FAR).random(2)
document = {
    "source": "scipy.stats.qmc.Sobol(64, scramble=False, bits=30), SciPy 1.17.1",
    "near_bits": 6,
    "near": integers(near, 6),
    "far_index": FAR,
    "far_bits": 30,
    "far": integers(far, 30),
    # Squared, as SciPy returns it; n is neither a power of two nor a multiple of four.
    "centred_discrepancy_of_first_50_points_in_5_dimensions": qmc.discrepancy(near[:50, :5], method="CD"),
}
print("{")
rows = []
for key, value in document.items():
    if isinstance(value, list):
        body = "[\n" + ",\n".join(f"    {json.dumps(row, separators=(',', ':'))}" for row in value) + "\n  ]"
    else:
        body = json.dumps(value)
    rows.append(f"  {json.dumps(key)}: {body}")
print(",\n".join(rows))
print("}")
