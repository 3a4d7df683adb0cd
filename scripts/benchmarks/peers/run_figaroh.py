"""figaroh in the race of scripts/benchmarks/benchmark_peers.py: its own choice of parameters, each of its solvers.

It wants a subclass and files: a configuration and a table, which are written here. The cost function, which it leaves
to the subclass, is the plain difference of positions: the same least squares as the log map that its examples use for
poses, and several times faster. Base and tool it finds in closed form by itself. Timed are create_param_list, where it
chooses and, but for its default method, fits a first time, and solve; not the reading.
"""

import contextlib
import io
import logging
import tempfile
import warnings
from pathlib import Path

import exchange
import numpy as np
import pandas as pd
import pinocchio as pin
import yaml
from exchange import Case, Solved, Stopwatch
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm


class Calibration(BaseCalibration):
    def __init__(self, robot: pin.RobotWrapper, config: str) -> None:
        super().__init__(robot, config)
        self.calib_config |= {"known_baseframe": False, "known_tipframe": False}

    def cost_function(self, var: np.ndarray) -> np.ndarray:
        return self.PEE_measured - calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)


def solve(case: Case, urdf: Path, setting: str) -> Solved:
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    robot = pin.RobotWrapper(pin.buildModelFromUrdf(str(urdf)))
    names = list(robot.model.names)[1:]
    with tempfile.TemporaryDirectory() as made, contextlib.redirect_stdout(io.StringIO()):
        table, config = Path(made) / "table.csv", Path(made) / "config.yaml"
        columns = {f"{axis}1": case.measured[:, k] for k, axis in enumerate("xyz")}
        columns |= {name: case.readings[:, k] for k, name in enumerate(names)}
        pd.DataFrame(columns).to_csv(table, index=False)
        config.write_text(yaml.safe_dump(configuration(len(case.readings), str(table), setting, names)))
        calibration = Calibration(robot, str(config))
        calibration.load_data_set()
        with Stopwatch() as watch:
            calibration.create_param_list()
            result = calibration.solve(enable_logging=False)
        settings = calibration.calib_config | {"NbSample": len(case.unseen)}
        flat = calc_updated_fkm(calibration.model, calibration.data, result.x, case.unseen, settings)
    left_out = [name for name in settings.get("absorbed_param_name") or [] if name not in settings["param_name"]]
    weak = [name for name, _ in settings.get("estimation_report", {}).get("removal_order", [])]
    said = f"{result.nfev} steps and differences; {len(left_out)} parameters left out as absorbed by others"
    if weak:
        said += f", {len(weak)} as too weakly excited"
    if dropped := getattr(calibration, "outlier_indices", None):
        said += f"; {len(dropped)} rows left out"
    return Solved(flat.reshape(3, -1).T, watch, len(result.x), bool(result.success), said)


def configuration(count: int, table: str, method: str, names: list[str]) -> dict[str, object]:
    return {
        "robot": {"name": "ur10", "properties": {"joints": {"active_joints": names}}},
        "tasks": {
            "calibration": {
                "enabled": True,
                "parameters": {
                    "calibration_level": "full_params",
                    "include_non_geometric": False,
                    "outlier_threshold": 0.05,
                    "estimation": {"method": method},
                },
                "kinematics": {"base_frame": "universe", "tool_frame": exchange.TIP},
                "measurements": {
                    "markers": [{"name": "probe", "measurable_dof": [True, True, True, False, False, False]}],
                    "poses": {"base_pose": [0.0] * 6, "tool_pose": [0.0] * 6},
                },
                "data": {"source_file": table, "validation_data_file": "", "number_of_samples": count},
            }
        },
    }


if __name__ == "__main__":
    exchange.run(solve, ("figaroh", "pin", "numpy", "scipy"))
