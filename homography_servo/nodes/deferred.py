"""
A Trigger service that answers when the work is done, not when it was asked.

A callback that waits would stop the node, and one that awaits keeps rclpy's executor
spinning at full load; so the answer is kept back and sent later with the header of
its request.
"""

from __future__ import annotations

from typing import Any, Callable

from homography_servo.result import Rejected
from std_srvs.srv import Trigger


class DeferredTrigger:
    """
    Offer a Trigger service whose answer is given by `answer`.

    Parameters
    ----------
    node : NodeKit
        The node that offers it.
    name : str
        Name of the service.
    begin : callable
        Begins the work, or says why not.

    """

    def __init__(self, node: Any, name: str, begin: Callable[[], Rejected | None]) -> None:
        self._node, self._begin = node, begin
        self._late: Trigger.Response | None = None
        self._header: Any = None
        self._service = node.create_service(Trigger, name, self._on_request)
        self._send, self._service.send_response = self._service.send_response, self._keep

    @property
    def waiting(self) -> bool:
        """Tell whether a caller still waits for an answer."""
        return self._header is not None

    def answer(self, success: bool, message: str) -> None:
        """Answer the caller, if one waits."""
        header, self._header = self._header, None
        if header is not None:
            self._send(Trigger.Response(success=success, message=message), header)

    def _on_request(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            refused = self._begin()
        except Exception as error:  # an operator must always get an answer
            self._node.failed(self._begin, error)
            refused = Rejected(f'internal error: {error}')
        if refused is None:
            self._late = response
        else:
            response.success, response.message = False, refused.reason
        return response

    def _keep(self, response: Trigger.Response, header: Any) -> None:
        if response is self._late:
            self._late, self._header = None, header
        else:
            self._send(response, header)
