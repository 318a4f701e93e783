"""Right BSDF plugins with Mueller matrices, and the same with one mistake each.

Each asks a plugin of Mitsuba's and changes its matrices. `MISTAKES` maps the name of a
broken plugin to the function that is guilty and to words of its mistake. The classes
are registered for a polarised variant and for the same without polarisation.
"""

import drjit as dr
import mitsuba as mi

ROUGH = {"type": "roughconductor", "eta": 0.2, "k": 3.0, "alpha": 0.3}
NESTED = {
    "brushed": ROUGH | {"alpha": 0.15, "alpha_v": 0.4},
    "glass": {"type": "dielectric"},
    "coated": {"type": "pplastic", "alpha": 0.2},
    "mirror_not_turned": {"type": "conductor", "eta": 0.2, "k": 3.0},
    "polarizer_twice_as_bright": {"type": "polarizer"},
}
NESTED["brushed"]["alpha_u"] = NESTED["brushed"].pop("alpha")

RIGHT = ("facets", "brushed", "glass", "coated", "r_p_right")

MISTAKES = {
    "not_turned": ("eval", "does not turn its frames"),
    "brushed_not_turned": ("eval", "does not turn its frames"),
    "mirror_not_turned": ("sample", "does not turn its frames"),
    "sample_not_turned": ("sample", "does not turn its frames"),
    "incident_not_turned": ("eval", "the frame of the incident beam"),
    "turned_the_wrong_way": ("eval", "the wrong way round"),
    "half_the_angle": ("eval", "instead of twice that"),
    "transposed": ("eval", "transposed"),
    "handedness_flipped": ("eval", "handedness of V changes sign on leaving"),
    "eval_depolarises": ("eval", "depolarises where `sample` does not"),
    "sample_depolarises": ("sample", "depolarises where `eval` does not"),
    "radiance_depolarises": ("eval", "in radiance mode"),
    "one_number": ("eval", "one number"),
    "mode_ignored": ("eval", "ctx.mode"),
    "too_coherent": ("eval", "too large"),
    "polarizer_twice_as_bright": ("sample", "not energy conserving"),
    "rotates_light": ("eval", "not reciprocal"),
    "first_element_off": ("eval", "missing"),
    "sample_mode_ignored": ("sample", "importance mode does, in radiance"),
    "sample_depolarises_radiance": ("sample", "does not, in radiance mode"),
    "eval_pdf_mode_ignored": ("eval_pdf", "otherwise than `eval`"),
    "pdf_off_in_radiance": ("sample or pdf", "densities differ"),
    "radiance_off": ("eval", "polarisation, in radiance mode"),
    "world_frames": ("eval", "directions in the world"),
    "mirror_world_frames": ("sample", "directions in the world"),
    "sample_depolarises_somewhere": ("sample", "depolarises where `eval` does not"),
    "glass_grazing_off": ("sample", "without polarisation"),
    "r_p_wrong": ("eval", "where wo = wi"),
    "mirror_r_p_wrong": ("sample", "jumps at the pole: its elements depend"),
    "mirror_radiance_off": ("sample", "polarisation, in radiance mode"),
}
NESTED["brushed_not_turned"] = NESTED["brushed"]
NESTED["mirror_world_frames"] = NESTED["mirror_not_turned"]
NESTED["glass_grazing_off"] = NESTED["glass"]
NESTED["mirror_r_p_wrong"] = NESTED["mirror_not_turned"]
NESTED["mirror_radiance_off"] = NESTED["mirror_not_turned"]


class Changed:
    """Asks a nested BSDF, and changes its matrices by name."""

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.name = props.plugin_name()
        self.nested = mi.load_dict(NESTED.get(self.name, ROUGH))
        self.m_flags = self.nested.flags()
        self.m_components = [
            self.nested.flags(i) for i in range(self.nested.component_count())
        ]

    def sample(self, ctx, si, sample1, sample2, active=True):
        bs, weight = self.nested.sample(
            self._mode("sample", ctx), si, sample1, sample2, active
        )
        return bs, self._changed("sample", ctx, weight, si, bs.wo)

    def eval(self, ctx, si, wo, active=True):
        value = self.nested.eval(self._mode("eval", ctx), si, wo, active)
        return self._changed("eval", ctx, value, si, wo)

    def pdf(self, ctx, si, wo, active=True):
        pdf = self.nested.pdf(ctx, si, wo, active)
        off = self.name == "pdf_off_in_radiance" and mi.is_polarized
        return 1.1 * pdf if off and _is_radiance(ctx) else pdf

    def eval_pdf(self, ctx, si, wo, active=True):
        value = self.eval(self._mode("eval_pdf", ctx), si, wo, active)
        return value, self.pdf(ctx, si, wo, active)

    def to_string(self):
        return f"Changed[{self.name}]"

    def _mode(self, function, ctx):
        if self.name == "mode_ignored":
            return mi.BSDFContext()
        if self.name == f"{function}_mode_ignored":
            return mi.BSDFContext(mi.TransportMode.Importance)
        return ctx

    def _changed(self, function, ctx, m, si, wo):
        name, wi = self.name, si.wi
        if not mi.is_polarized or name in RIGHT[:4]:
            return m
        radiance = _is_radiance(ctx)
        beams = (-wo, wi) if radiance else (-wi, wo)
        if "r_p" in name:
            # in the plane of incidence of the facet, which none is at its pole
            sign = 1 if name == "r_p_right" else -1
            s = dr.cross(beams[0], wi + wo)
            s = dr.select(dr.norm(s) > 1e-4, dr.normalize(s), mi.Vector3f(0, 1, 0))
            turn_in, turn_out = (mi.mueller.rotator(_to_axis(k, s)) for k in beams)
            plane = turn_out @ m @ turn_in.T
            return turn_out.T @ _diagonal(1, 1, sign, sign) @ plane @ turn_in
        light = m[0, 0]
        if name == "glass_grazing_off":  # from the front, beyond 60 degrees
            return dr.select((wi.z > 0) & (wi.z < 0.5), 0.9 * m, m)
        if name.endswith("radiance_off"):
            return 0.9 * m if radiance else m
        if name == f"{function}_depolarises_radiance":
            return mi.mueller.depolarizer(light) if radiance else m
        if name == f"{function}_depolarises_somewhere":
            return dr.select(si.uv.x < 0.2, mi.mueller.depolarizer(light), m)
        if name in (f"{function}_depolarises", "radiance_depolarises"):
            one_mode = name.startswith("radiance")
            return m if one_mode and not radiance else mi.mueller.depolarizer(light)
        if name == "one_number":
            return mi.Spectrum(light)
        if name == "first_element_off":
            return 0.9 * m
        if name == "polarizer_twice_as_bright":
            return 2 * m
        if name == "transposed":
            return m.T
        if name == "handedness_flipped":
            return _diagonal(1, 1, 1, -1) @ m
        if not any(word in name for word in ("turned", "world")) and name not in (
            "half_the_angle",
            "too_coherent",
            "rotates_light",
        ):
            return m
        if name.endswith("world_frames"):
            turn_in, turn_out = (mi.mueller.rotator(_to_world(si, k)) for k in beams)
            return turn_out @ m @ turn_in.T
        angle_in, angle_out = (_angle(k) for k in beams)
        turn_in, turn_out = (mi.mueller.rotator(a) for a in (angle_in, angle_out))
        plane = turn_out @ m @ turn_in.T
        if name == "sample_not_turned":
            return plane if function == "sample" else m
        if name.endswith("not_turned"):
            return m @ turn_in.T if name.startswith("incident") else plane
        if name == "turned_the_wrong_way":
            return turn_out @ plane @ turn_in.T
        if name == "half_the_angle":
            turn_in, turn_out = (
                mi.mueller.rotator(a / 2) for a in (angle_in, angle_out)
            )
        elif name == "too_coherent":
            plane = plane + 0.1 * _diagonal(0, 0, 1, 1) @ plane @ _diagonal(0, 0, 1, 1)
        elif name == "rotates_light":
            plane = mi.mueller.rotator(mi.Float(0.3)) @ plane
        return turn_out.T @ plane @ turn_in


def _is_radiance(ctx):
    return ctx.mode == mi.TransportMode.Radiance


def _diagonal(*values):
    m = dr.zeros(mi.Spectrum)
    for i, value in enumerate(values):
        m[i, i] = mi.UnpolarizedSpectrum(value)
    return m


def _to_world(si, k):
    """From Mitsuba's frame of the local beam to that of its direction in the world."""
    return _to_axis(k, si.to_local(mi.mueller.stokes_basis(si.to_world(k))))


def _angle(k):
    """From Mitsuba's frame of the beam to that of s = k x z."""
    return _to_axis(k, dr.cross(k, mi.Vector3f(0, 0, 1)))


def _to_axis(k, new):
    """From Mitsuba's frame of the beam to that of another first axis."""
    old = mi.mueller.stokes_basis(k)
    return dr.atan2(dr.dot(k, dr.cross(old, new)), dr.dot(old, new))


def register():
    """Register all plugins for the variant that is set."""
    methods = {
        name: value
        for name, value in vars(Changed).items()
        if name not in ("__dict__", "__weakref__")
    }
    kind = type("Changed", (mi.BSDF,), methods)
    for name in (*RIGHT, *MISTAKES):
        mi.register_bsdf(name, kind)
