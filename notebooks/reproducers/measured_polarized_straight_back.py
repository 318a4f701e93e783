# measured_polarized: where wo is exactly wi, the matrix has elements that are NaN.
# Their number, of a table that is the same matrix everywhere, and 0.
import struct
import tempfile

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono_polarized")
nodes = {"theta_h": [0, 1.6], "theta_d": [0, 1.6], "phi_d": [-3.15, 3.15]}
fields = {name: np.float32([x]) for name, x in nodes.items()}
fields["M"] = np.full((2, 2, 2, 5, 4, 4), 0.1 * np.eye(4), np.float32)
fields["wvls"] = np.uint16([450, 500, 550, 600, 650])
head, place = b"tensor_file\0\1\0" + struct.pack("<I", len(fields)), 256
for name, x in fields.items():
    kind = {"f": 10, "u": 3}[x.dtype.kind]  # float32 or uint16
    head += struct.pack("<H", len(name)) + name.encode()
    head += struct.pack(f"<HBQ{x.ndim}Q", x.ndim, kind, place, *x.shape)
    place += x.nbytes
with tempfile.NamedTemporaryFile(buffering=0) as file:
    file.write(head.ljust(256) + b"".join(x.tobytes() for x in fields.values()))
    table = {"type": "measured_polarized", "filename": file.name, "wavelength": 550.0}
    bsdf = mi.load_dict(table)
si = dr.zeros(mi.SurfaceInteraction3f, 1)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
value = bsdf.eval(mi.BSDFContext(), si, si.wi)
a, b = np.count_nonzero(np.isnan(np.ravel(value))), 0
print(f"{a} and {b}, which must be equal: {a == b}")
