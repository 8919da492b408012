"""What the watcher of a graph waits for."""

from __future__ import annotations

from mig_interfaces.msg import TrialState
from rig_bringup.monitor import Monitor


def test_only_a_trial_in_lockstep_that_ran_to_its_end_owes_its_pace() -> None:
    with Monitor("rig") as monitor:
        assert monitor.pace_known
        for pacing in (TrialState.PACING_REALTIME, TrialState.PACING_LOCKSTEP):
            for phase in (TrialState.PHASE_RUNNING, TrialState.PHASE_ABORTED, TrialState.PHASE_FINISHED):
                monitor.trial = TrialState(pacing=pacing, phase=phase)
                owed = (TrialState.PACING_LOCKSTEP, TrialState.PHASE_FINISHED)
                assert monitor.pace_known is ((pacing, phase) != owed)
        monitor.values["/rig/task_sim"] = {"trial time [s]": "30.0", "wall time [s]": "0.6"}
        assert monitor.pace_known
        assert monitor.speed() == 50.0
