# %% [markdown]
# # The paper's three cases, and changes to them
#
# Figures 4 and 6 to 11 of Medagoda & Williams (OCEANS 2012) from simulations in this process: no control, 2.5 s and
# 5 s of horizon, with the paper's cost, computing delays, sensors and one satellite fix. Then one change each: the
# horizon, the current, the vehicle, the solver, a limit of your own.
#
# This notebook is kept as text: `jupytext --to ipynb examples/paper.py`, or open it in Jupyter with jupytext.

# %%
import matplotlib.pyplot as plt
import numpy as np

from ltv_mpc import Limit, simulate

DURATION_S, SEED = 200.0, 3
CASES = {"no control": "paper-no-control", "2.5 s": "paper-2.5s", "5 s": "paper-5s"}
runs = {name: simulate(scenario, seed=SEED, duration_s=DURATION_S) for name, scenario in CASES.items()}
runs["5 s"]

# %% [markdown]
# A run has a table of arrays for each key of the protocol. The names carry the units.

# %%
estimate = runs["5 s"]["estimate"]
estimate["north_m"].shape, estimate.units["velocity_north_mps"], runs["5 s"].summary["tracking_error_m"]


# %%
def estimated(run):
    """Return the times and the estimated north and east from the line, which begins at the estimate at t = 0."""
    table = run["estimate"]
    after = table["t_s"] >= 0.0
    position = np.column_stack([table["north_m"], table["east_m"]])[after]
    return table["t_s"][after], position - position[0]


def true(run):
    """Return the times and the true north and east since t = 0."""
    table = run["world/truth"]
    after = table["t_s"] >= 0.0
    position = table["position_m"][after, :2]
    return table["t_s"][after], position - position[0]


def north_and_east(title, of, shown=runs):
    """Plot north and east over time."""
    figure, panels = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
    for axis, (panel, name) in enumerate(zip(panels, ("north", "east"), strict=True)):
        for label, run in shown.items():
            t_s, position_m = of(run)
            panel.plot(t_s, position_m[:, axis], label=label)
        panel.set(xlabel="time (s)", ylabel=f"{name} (m)")
    panels[0].legend()
    figure.suptitle(title)


# %% [markdown]
# ## Figure 4: the current, north and east over depth

# %%
truth = runs["5 s"]["world/truth"]
figure, panel = plt.subplots(figsize=(4, 4), layout="constrained")
for axis, name in enumerate(("north", "east")):
    panel.plot(truth["current_mps"][:, axis], truth["position_m"][:, 2], label=name)
panel.set(xlabel="velocity (m/s)", ylabel="depth (m)")
panel.invert_yaxis()
panel.legend()

# %% [markdown]
# ## Figure 6: estimated north and east; figure 10: true north and east

# %%
north_and_east("Estimated", estimated)
north_and_east("True", true)

# %% [markdown]
# ## Figure 7: total tracking error

# %%
figure, panel = plt.subplots(figsize=(6, 3), layout="constrained")
for name, run in runs.items():
    t_s, position_m = estimated(run)
    panel.semilogy(t_s, np.hypot(*position_m.T), label=name)
panel.set(xlabel="time (s)", ylabel="tracking error (m)", ylim=(1e-3, None))
panel.legend()

# %% [markdown]
# ## Figures 8 and 9: thrusts at 2.5 s and 5 s, with their bounds of 62.5 N

# %%
figure, panels = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
for panel, name in zip(panels, ("2.5 s", "5 s"), strict=True):
    applied = runs[name]["applied"]
    panel.plot(applied["t_s"], applied["command_N"][:, :2], label=["port", "starboard"])
    panel.axhline(62.5, linestyle=":", color="grey")
    panel.axhline(-62.5, linestyle=":", color="grey")
    share = runs[name].summary["thrust"]["saturated_fraction"]
    panel.set(ylabel="thrust (N)", title=f"{name}: saturated {share:.0%} of the time")
panels[0].legend()
panels[1].set_xlabel("time (s)")


# %% [markdown]
# ## Figure 11: error of the estimated current at the end, and two standard deviations


# %%
def current_error(run):
    """Return depths where the vehicle has been, the errors (K, 2) and the standard deviations of the current."""
    table, known = run["estimate"], run["world/truth"]
    depth_m, order = table["current.depth_m"][-1], np.argsort(known["position_m"][:, 2])
    errors = [
        table[f"current.{name}_mps"][-1]
        - np.interp(depth_m, known["position_m"][order, 2], known["current_mps"][order, axis])
        for axis, name in enumerate(("north", "east"))
    ]
    been = depth_m <= known["position_m"][:, 2].max()
    return depth_m[been], np.column_stack(errors)[been], table["current.sd_mps"][-1][been]


depth_m, error_mps, sd_mps = current_error(runs["5 s"])
figure, panels = plt.subplots(1, 2, figsize=(7, 4), sharey=True, layout="constrained")
for axis, (panel, name) in enumerate(zip(panels, ("north", "east"), strict=True)):
    panel.plot(error_mps[:, axis], depth_m)
    panel.fill_betweenx(depth_m, -2 * sd_mps, 2 * sd_mps, alpha=0.2)
    panel.set(xlabel=f"error {name} (m/s)")
panels[0].set_ylabel("depth (m)")
panels[0].invert_yaxis()


# %% [markdown]
# ## One change each
#
# A setting is named by the last part of its key; a table of settings is a dict. `ltv-mpc sim` takes the same keys.


# %%
class TotalThrust(Limit):
    """|F1 + F2| <= 20 N; docs/add-limit.md explains limits of your own."""

    low, high, unit = (-20.0,), (20.0,), (62.5,)

    def values(self, motion):
        """Return the sum of port and starboard command at each knot."""
        return motion.states[:, 8:10].sum(axis=1, keepdims=True)


common = {"seed": SEED, "duration_s": DURATION_S}
changed = {
    "defaults": simulate("descent", **common),
    "horizon 4 s": simulate("descent", horizon_s=4.0, **common),
    "current twice as strong": simulate("descent", water={"sd_mps": 0.08}, **common),
    "vehicle low-yaw": simulate("descent", vehicle="low-yaw", **common),
    "solver riccati": simulate("descent", solver="riccati", **common),
    "|F1 + F2| <= 20 N": simulate("descent", terms=[TotalThrust()], **common),
}
for name, run in changed.items():
    summary = run.summary
    print(f"{name:24} {summary['tracking_error_m']['mean']:6.3f} m  {summary['thrust']['mean_abs_N']:5.1f} N")
north_and_east("True, one change each", true, changed)
