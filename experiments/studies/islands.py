"""Physical mode on random days and on the packaged one."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer

from benchmarks.frame.random_feeders import random_scenario
from benchmarks.frame.seeds import Days, FirstSeed
from vppres.contract.forecast import ForecastErrors
from vppres.core.errors import VppresError
from vppres.day.metrics import resilience
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.io import find_scenario, read_scenario
from vppres.scenario.scenario import Scenario

STEPS = 5
BALANCE_TOLERANCE_KW = 1e-4
ERRORS = ForecastErrors(load_bias=0.05, load_alpha_per_h=0.05, pv_bias=-0.1, pv_alpha_per_h=0.1)
VARIANTS: dict[str, dict[str, Any]] = {
    "paper": {"mode": "paper"},
    "physical": {"mode": "physical"},
    "without headroom": {"mode": "physical", "headroom": 0.0},
}
PACKAGED = "uk-heatwave-2022"


@dataclass(frozen=True)
class Claims:
    """Worst violation of each claim over a run; all but the last two must be zero."""

    import_kw: float  #: largest import in an island
    voltage_steps: int  #: steps that claim AC voltages within the limits without it
    balance_kw: float  #: largest difference of generation to served load and losses
    soc: float  #: largest excess over the limits of the state of charge
    dark_served: int  #: customers that count as served in the dark
    #: Steps in the dark, and lit steps outside the AC limits that say so.
    dark_steps: int
    outside_steps: int

    @property
    def kept(self) -> bool:
        """Whether nothing that the record claims is untrue."""
        return (
            self.import_kw == 0.0
            and self.voltage_steps == 0
            and self.soc <= 1e-9
            and self.balance_kw <= BALANCE_TOLERANCE_KW
            and self.dark_served == 0
        )


def claims_of(run: Trajectory) -> Claims:
    """What a run's record claims, held against its own tables."""
    s = run.scenario
    steps = run.steps
    T = len(steps)
    net = s.network
    b = s.batteries
    island = steps["outage"].to_numpy(bool)
    dark = steps["dark"].to_numpy() > 0
    v = run.buses["v_ac_pu"].to_numpy().reshape(T, -1)
    inside = ((v >= net.v_min_ac_pu) & (v <= net.v_max_ac_pu)).all(axis=1)
    claimed = steps["v_within_ac"].to_numpy() > 0
    served = run.customers["served"].to_numpy(bool).reshape(T, -1)
    soc = run.batteries["soc_end"].to_numpy(float).reshape(T, -1)
    return Claims(
        import_kw=float(steps.loc[island, "p_grid_kw"].abs().max()) if island.any() else 0.0,
        voltage_steps=int((claimed & ~inside).sum()),
        balance_kw=float(np.abs(imbalance_kw(run)).max()),
        soc=float(np.max([b.soc_min - soc, soc - b.soc_max], initial=0.0)),
        dark_served=int(served[dark].sum()),
        dark_steps=int(dark.sum()),
        outside_steps=int((~claimed & ~dark).sum()),
    )


def imbalance_kw(run: Trajectory) -> np.ndarray:
    """Import and generation less served load, charging and AC losses, (T,)."""
    load = run.customers.assign(kw=run.customers["p_load_kw"] * run.customers["served"])
    pv = run.pv.assign(kw=run.pv["self_kw"] + run.pv["export_kw"])
    battery = run.batteries.assign(kw=run.batteries["discharge_kw"] - run.batteries["charge_kw"])
    times = run.steps["time"]
    load_kw, pv_kw, battery_kw = (
        table.groupby("time")["kw"].sum().reindex(times, fill_value=0.0).to_numpy()
        for table in (load, pv, battery)
    )
    grid = run.steps["p_grid_kw"].to_numpy() - run.steps["losses_kw"].to_numpy()
    return np.asarray(grid + pv_kw + battery_kw - load_kw)


def random_day(seed: int) -> tuple[Scenario, RunOptions]:
    """A random feeder's day in physical mode: stressed or not, with and without forecast errors."""
    day = random_scenario(seed, stressed=seed % 2 == 1, n_steps=STEPS)
    return day, RunOptions(
        mode="physical",
        horizon_h=2 * day.grid.dt_h,
        seed=seed,
        controller="full-horizon" if seed % 5 == 4 else "mpc",
        errors=ERRORS if seed % 3 == 0 else ForecastErrors(),
    )


def study_random(seeds: range) -> pd.DataFrame:
    """One row per random day: claims, resilience in both modes, process time in s."""
    rows = []
    for seed in seeds:
        day, options = random_day(seed)
        row: dict[str, object] = {"seed": seed, "error": ""}
        try:
            for mode in ("paper", "physical"):
                begin = time.process_time()
                run = run_day(day, replace(options, mode=mode))
                row |= {f"{mode}_s": time.process_time() - begin, f"{mode}_r": resilience(run)}
            claims = claims_of(run)
            row |= vars(claims) | {
                "kept": claims.kept,
                "passes": run.steps["passes"].max(),
                "v_error_pu": run.steps["v_error_pu"].max(),
                "mismatch_kw": run.steps["island_mismatch_kw"].abs().max(),
                "shed_kw": run.steps["shed_kw"].sum(),
            }
        except VppresError as error:
            row["error"] = f"{type(error).__name__}: {error}"
        rows.append(row)
    return pd.DataFrame(rows)


def study_packaged() -> pd.DataFrame:
    """The packaged day in the paper's mode, in physical mode, and with parts of it left out."""
    day = read_scenario(find_scenario(PACKAGED))
    run_day(day)  # problems of the paper's mode are compiled before the clock runs
    run_day(day, RunOptions(mode="physical"))
    rows = []
    for name, changes in VARIANTS.items():
        begin = time.process_time()
        run = run_day(day, RunOptions(**changes))
        island = run.steps["outage"].to_numpy(bool)
        rows.append(
            {
                "variant": name,
                "resilience": resilience(run),
                "process_s": time.process_time() - begin,
                "v_error_pu": run.steps["v_error_pu"].max(),
                "v_min_ac_pu": run.steps["v_min_ac_pu"].min(),
                "mismatch_kw": run.steps["island_mismatch_kw"].abs().max(),
                "shed_kw": run.steps["shed_kw"].sum(),
                "island_losses_kwh": run.steps.loc[island, "losses_kw"].sum() * day.grid.dt_h,
                "passes": run.steps["passes"].mean(),
            }
        )
    return pd.DataFrame(rows)


def main(
    days: Days = 200,
    first: FirstSeed = 0,
    out: Annotated[Path, typer.Option(help="Folder of the two tables.")] = Path("results/islands"),
) -> None:
    """Hold the record of physical mode against its claims, on random days and the packaged one."""
    out.mkdir(parents=True, exist_ok=True)
    packaged = study_packaged()
    packaged.to_csv(out / "packaged.csv", index=False)
    typer.echo(packaged.to_string(index=False))
    table = study_random(range(first, first + days))
    table.to_csv(out / "random.csv", index=False)
    broken = table[(table["error"] != "") | ~table["kept"].fillna(False).astype(bool)]
    lit = table[table["dark_steps"] == 0]
    typer.echo(
        f"{days} days: {days - len(broken)} keep every claim. Process time "
        f"{table['physical_s'].sum() / table['paper_s'].sum():.2f} x the paper's mode. "
        f"Resilience without dark steps {lit['physical_r'].mean():.4f}, in the paper's mode "
        f"{lit['paper_r'].mean():.4f}."
    )
    if len(broken):
        typer.echo(broken.to_string(index=False))
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
