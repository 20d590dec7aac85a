"""The commands, classes and properties of OpenDSS that a network needs.

Anything else of a script is refused, so this is the whole surface that a stranger's file has.
Of each property it says how its value is read: ``n`` a number, ``l`` numbers in rows, ``w`` a name
or ``yes`` and ``no``, ``ws`` names. What shapes demand over time, meters or controls is known by
its name and left out; OpenDSS does not see it.
"""

from __future__ import annotations

Kinds = dict[str, str]


def _kinds(**words: str) -> Kinds:
    """Kind of each property; ``n`` holds the names of the numbers, and so on."""
    return {name: kind for kind, names in words.items() for name in names.split()}


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_COMMON = _kinds(n="basefreq", w="enabled like")
_RATING = _kinds(n="normamps emergamps faultrate pctperm repair seasons", l="ratings")
_INVERTER = _kinds(
    n="%cutin %cutout %r %x model vminpu vmaxpu dutystart %pminnovars %pminkvarmax kvarmax "
    "kvarmaxabs kvdc kp pitol safevoltage",
    w="balanced limitcurrent varfollowinverter wattpriority pfpriority safemode",
)
_BANK = _kinds(
    n="phases windings wdg kv kva tap %r rneut xneut xhl xht xlt x12 x13 x23 thermal n m flrise "
    "hsrise %loadloss %noloadloss normhkva emerghkva maxtap mintap numtaps %imag ppm_antifloat "
    "ppm rdcohms",
    l="kvs kvas taps xscarray %rs",
    w="conn",
    ws="conns",
)
_WIRE = _kinds(
    n="rdc rac gmrac radius capradius normamps emergamps diam seasons",
    l="ratings",
    w="runits gmrunits radunits like",
)
_CABLE = _WIRE | _kinds(n="epsr inslayer diains diacable")

NETWORK: dict[str, Kinds] = {
    "vsource": _COMMON
    | _kinds(
        n="basekv pu angle frequency phases mvasc3 mvasc1 x1r1 x0r0 isc3 isc1 r1 x1 r0 x0 basemva",
        l="z1 z0 z2 puz1 puz0 puz2",
        w="bus1 bus2",
    ),
    "line": _COMMON
    | _RATING
    | _kinds(
        n="length phases r1 x1 r0 x0 c1 c0 b1 b0 rg xg rho",
        l="rmatrix xmatrix cmatrix",
        w="bus1 bus2 linecode switch geometry units spacing earthmodel linetype",
        ws="wires cncables tscables",
    ),
    "linecode": _COMMON
    | _RATING
    | _kinds(
        n="nphases r1 x1 r0 x0 c1 c0 b1 b0 rg xg rho neutral",
        l="rmatrix xmatrix cmatrix",
        w="units kron linetype",
    ),
    "linegeometry": _RATING
    | _kinds(
        n="nconds nphases cond x h",
        w="wire cncable tscable units reduce spacing like linetype",
        ws="wires cncables tscables",
    ),
    "linespacing": _kinds(n="nconds nphases", l="x h", w="units like"),
    "wiredata": _WIRE,
    "cndata": _CABLE | _kinds(n="k diastrand gmrstrand rstrand"),
    "tsdata": _CABLE | _kinds(n="diashield tapelayer tapelap"),
    "xfmrcode": _COMMON | _RATING | _BANK,
    "transformer": _COMMON
    | _RATING
    | _BANK
    | _kinds(w="bus sub subname bank xfmrcode xrconst leadlag core", ws="buses"),
    "load": _COMMON
    | _kinds(
        n="phases kv kw pf model kvar rneut xneut vminpu vmaxpu vminnorm vminemerg xfkva "
        "allocationfactor kva %mean %stddev cvrwatts cvrvars kwh kwhdays cfactor numcust "
        "%seriesrl relweight vlowpu puxharm xrharm",
        l="zipv",
        w="bus1 conn",
    ),
    "generator": _COMMON
    | _kinds(
        n="phases kv kw pf kvar model vminpu vmaxpu dispvalue vpu maxkvar minkvar pvfactor kva mva "
        "xd xdp xdpp h d xrdp dutystart",
        w="bus1 conn forceon balanced",
    ),
    "pvsystem": _COMMON
    | _INVERTER
    | _kinds(n="phases kv irradiance pmpp %pmpp temperature pf kvar kva", w="bus1 conn"),
    "storage": _COMMON
    | _INVERTER
    | _kinds(
        n="phases kv kw kvar pf kva kwrated %kwrated kwhrated kwhstored %stored %reserve "
        "%discharge %charge %effcharge %effdischarge %idlingkw %idlingkvar dischargetrigger "
        "chargetrigger timechargetrig",
        w="bus1 conn state",
    ),
    "capacitor": _COMMON
    | _RATING
    | _kinds(n="phases kv numsteps", l="kvar cmatrix cuf r xl harm states", w="bus1 bus2 conn"),
    "reactor": _COMMON
    | _RATING
    | _kinds(
        n="phases kvar kv r x rp lmh", l="rmatrix xmatrix z1 z2 z0 z", w="bus1 bus2 conn parallel"
    ),
    "regcontrol": _COMMON
    | _kinds(
        n="winding vreg band ptratio ctprim r x delay revvreg revband revr revx tapdelay "
        "maxtapchange tapwinding vlimit revthreshold revdelay remoteptratio tapnum ldc_z rev_z",
        w="transformer bus reversible inversetime ptphase revneutral cogen",
    ),
    "swtcontrol": _COMMON
    | _kinds(n="switchedterm delay", w="switchedobj action lock normal state reset"),
}
"""Classes that OpenDSS sees, and their properties; ``circuit`` has those of ``vsource``."""

NETWORK["circuit"] = NETWORK["vsource"]

IDLE_PROPERTIES = _words(
    "yearly daily duty spectrum growth class status tyearly tdaily tduty cvrcurve effcurve "
    "p-tcurve dispmode eventlog"
)
"""Properties of those classes that are left out: they change nothing at nominal load."""

IDLE = _words(
    "capcontrol energymeter monitor sensor fuse relay recloser loadshape growthshape tshape "
    "priceshape xycurve tcc_curve spectrum"
)
"""Classes that are left out, whatever their properties are."""

LIBRARIES = frozenset(
    {"linecode", "linegeometry", "linespacing", "wiredata", "cndata", "tsdata", "xfmrcode"}
)
"""Classes that a file beside the master's folder may define: data sheets, no elements."""

OPTIONS = _kinds(n="defaultbasefrequency defaultbasefreq", l="voltagebases")
"""Options of ``set`` that OpenDSS sees."""

IDLE_OPTIONS = _words(
    "maxcontroliter maxcontroliterations maxiterations maxiter tolerance loadmult normvminpu "
    "normvmaxpu emergvminpu emergvmaxpu %normal %growth genmult pricesignal controlmode loadmodel "
    "algorithm mode markertransformers marktransformers markregulators markcapacitors trapezoidal "
    "cktmodel"
)
"""Options that only a solution or a plot would use; they are left out."""

SKIPPED = {
    "calcvoltagebases": "is done by the reader itself",
    "makebuslist": "is done by the reader itself",
    "solve": "is left out: the network is read, not solved",
    "buscoords": "is left out: coordinates are not used",
    "latlongcoords": "is left out: coordinates are not used",
}
"""Commands that are not carried out and, without arguments that matter, do no harm."""

MATHS = _words(
    "+ - * / ^ sqr sqrt inv exp ln log10 sin cos tan asin acos atan atan2 swap rollup rolldn pi"
)
"""Operators of the arithmetic in parentheses that the published feeders use."""
