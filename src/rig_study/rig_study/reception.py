"""Where an operator chooses whose session is led next: ``conductor/choices`` and ``conductor/choose``, on any node."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from mig_interfaces.msg import StudyChoices, StudySubject
from mig_interfaces.srv import ChooseSession
from rig_runtime import topics
from rig_study.declared import StudyError
from rig_study.studies import Choice, Studies, Subject

__all__ = ["Reception"]

_PERIOD = 1.0  # [s] between two looks at what is on the disk


class Reception:
    """Offers sessions and takes one choice.

    Parameters
    ----------
    node: that is being served; the conductor, or one that waits in its place.
    studies: what there is.
    busy: why no session can be left for another now; empty if it can.
    said: what became of the choice before, for people to read, if it went wrong.
    """

    def __init__(self, node: Node, studies: Studies, busy: Callable[[], str] = str, said: str = "") -> None:
        self.choice: Choice | None = None
        self._studies = studies
        self._busy = busy
        self._message, self._failed = said, bool(said)
        self._listing: tuple[Subject, ...] | None = None
        topic = topics.STUDY_CHOICES
        self._teller = node.create_publisher(topic.type, topic.name, topic.qos)
        node.create_service(ChooseSession, topics.CHOOSE_SERVICE, self._choose)
        node.create_timer(_PERIOD, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._look()

    def _look(self) -> None:
        listing = self._studies.listing()
        if listing != self._listing:
            self._listing = listing
            self._tell()

    def _tell(self) -> None:
        subjects = [
            StudySubject(
                protocol=subject.protocol,
                title=subject.title,
                subject=subject.name,
                group=subject.group,
                trials_done=subject.done,
                trials_planned=subject.planned,
                problem=subject.problem,
            )
            for subject in self._listing or ()
        ]
        self._teller.publish(StudyChoices(subjects=subjects, message=self._message, failed=self._failed))

    def _choose(self, request: ChooseSession.Request, response: ChooseSession.Response) -> ChooseSession.Response:
        try:
            refusal = f"{self.choice} begins already" if self.choice is not None else self._busy()
            if refusal:
                raise StudyError(refusal)
            self.choice = self._studies.choose(request.protocol, request.subject)
        except StudyError as error:
            response.message = str(error)
            return response
        response.success = True
        response.message = self._message = f"{self.choice} begins: the graph is being started"
        self._failed = False
        self._tell()
        return response
