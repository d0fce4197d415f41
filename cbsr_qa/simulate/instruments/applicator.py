"""An emulated Cartesian force applicator controlled by G-code: a Prusa MK3, or a printer with stock Marlin."""

import threading
from collections.abc import Callable, Mapping
from functools import reduce
from operator import xor
from typing import Any, Final

from cbsr_qa.simulate.instruments.head import Position
from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.streams import Fault

#: Longer lines are truncated by the firmware's buffer.
LONGEST_LINE: Final = 96


#: A line's number, its command, and the firmware's error message if it is wrong.
NumberedLine = tuple[int | None, str, str]


def checksum(text: str) -> int:
    """XOR of the bytes before the asterisk."""
    return reduce(xor, text.encode("ascii", "replace"), 0)


def read_line(raw: bytes, last: int) -> NumberedLine:
    """Parse one line as Marlin's queue does."""
    text = raw[: LONGEST_LINE - 1].decode("ascii", "replace").split(";")[0].strip()
    body, star, checksum_text = text.partition("*")
    if not text.startswith("N"):
        return None, body.strip(), "No Line Number with checksum" if star else ""
    digits, _, command = body[1:].partition(" ")
    if not digits.lstrip("-").isdigit():
        return None, command, "Line Number is not Last Line Number+1"
    number = int(digits)
    if not star:
        return number, command, "No Checksum with line number"
    if not checksum_text.isdigit() or int(checksum_text) != checksum(body):
        return number, command, "checksum mismatch"
    if number != last + 1 and "M110" not in command:
        return number, command, "Line Number is not Last Line Number+1"
    return number, command.strip(), ""


def words(command: str) -> tuple[str, dict[str, float | None]]:
    """Split a command into code and parameters; None for parameters without a number."""
    code, *parameter_words = command.split() or [""]
    parameters: dict[str, float | None] = {}
    for word in parameter_words:
        try:
            parameters[word[0].upper()] = float(word[1:])
        except ValueError:
            parameters[word[0].upper()] = None
    return code.upper(), parameters


Parameters = Mapping[str, float | None]

#: Far corner of the machine [mm]; its end stops are at 0.
REACH_MM: Final[Position] = (250.0, 210.0, 210.0)
_AXES: Final = "XYZ"
_HOMING_MM_S: Final = (50.0, 50.0, 800 / 60)
_HOMING_LIFT_MM: Final = 5.0
#: Mesh levelling, which a plain G28 does on a Prusa [s].
_LEVELLING_S: Final = 60.0
_FASTEST_MM_S: Final = (200.0, 200.0, 12.0)
#: Most queued moves; another one waits before it is acknowledged.
_BUFFER: Final = 16
_BUSY: Final = b"echo:busy: processing\n"
_BUSY_EVERY_S: Final = 2.0
#: Number and spacing of messages of a BUSY fault [s, real time].
BUSY_MESSAGES: Final = 3
BUSY_PAUSE_S: Final = 0.45

_BANNER: Final = {
    "prusa": "start\necho: 3.13.3-7094\necho: Free Memory: 1737  PlannerBufferBytes: 1312\n",
    "marlin": "start\necho:Marlin 2.1.2.4\necho: Free Memory: 2815  PlannerBufferBytes: 1168\n",
}
_FIRMWARE: Final = {
    "prusa": (
        "FIRMWARE_NAME:Prusa-Firmware 3.13.3 based on Marlin FIRMWARE_URL:https://github.com/prusa3d/Prusa-Firmware "
        "PROTOCOL_VERSION:1.0 MACHINE_TYPE:Prusa i3 MK3S EXTRUDER_COUNT:1 UUID:00000000-0000-0000-0000-000000000000\n"
        "Cap:AUTOREPORT_TEMP:1\nCap:AUTOREPORT_FANS:1\nCap:AUTOREPORT_POSITION:1\nCap:EXTENDED_M20:1\n"
    ),
    "marlin": (
        "FIRMWARE_NAME:Marlin 2.1.2.4 SOURCE_CODE_URL:github.com/MarlinFirmware/Marlin PROTOCOL_VERSION:1.0 "
        "MACHINE_TYPE:3D Printer EXTRUDER_COUNT:1 UUID:cede2a2f-41a2-4748-9b12-c55c62f367ff\n"
        "Cap:SERIAL_XON_XOFF:0\nCap:EEPROM:1\nCap:AUTOREPORT_POS:0\nCap:EMERGENCY_PARSER:1\n"
        "area:{full:{min:{x:0.0000,y:0.0000,z:0.0000},max:{x:220.0000,y:220.0000,z:250.0000}}}\n"
    ),
}


class EmulatedApplicator:
    """Moves the rig's head by G-code.

    An ``ok`` to a move means that it is queued. Its position is the assumed one: until homing, and after every reset,
    that is zero wherever the head is. ``options``: of the driver's table: ``firmware``, ``steps_per_mm``,
    ``centre_mm``, ``hover_height_mm``, ``z_axis``.
    """

    def __init__(self, rig: EmulatedRig, options: Mapping[str, Any], send: Callable[[bytes], None]) -> None:
        self._rig, self._head, self._send = rig, rig.head, send
        self._firmware = options.get("firmware", "prusa")
        self._steps = tuple(options.get("steps_per_mm", (100.0, 100.0, 400.0)))
        x, y = options.get("centre_mm", (0.0, 0.0))
        with rig.lock:
            rig.head.mount_over(
                (x, y), options.get("hover_height_mm", rig.motion.hover_mm), up=options.get("z_axis", "up") == "up"
            )
        self._partial = b""
        self._told: set[Fault] = set()
        self._reset()
        send(_BANNER[self._firmware].encode())

    def receive(self, data: bytes) -> bytes:
        if Fault.BUSY in self._told:
            self._told.discard(Fault.BUSY)
            for _ in range(BUSY_MESSAGES):
                self._send(_BUSY)
                threading.Event().wait(BUSY_PAUSE_S)
                self._rig.clock.sleep(_BUSY_EVERY_S)
        if Fault.RESET in self._told:
            self._told.discard(Fault.RESET)
            return self._restart()
        reply = ""
        with self._rig.lock:
            *lines, self._partial = (self._partial + data).split(b"\n")
            for line in lines:
                reply += self._handle_line(line)
        return reply.encode()

    def misbehave(self, fault: Fault) -> None:
        """Inject a fault: request a resend, report busy, or restart."""
        if fault in (Fault.RESEND, Fault.BUSY, Fault.RESET):
            self._told.add(fault)

    def _restart(self) -> bytes:
        with self._rig.lock:
            self._reset()
        return _BANNER[self._firmware].encode()

    def _reset(self) -> None:
        self._head.stop()
        self._partial = b""
        self._last = 0
        self._absolute = True
        self._speed_mm_s = 25.0
        self._offset: Position = self._head.target_mm  # the machine position that the firmware now calls 0

    def _handle_line(self, raw: bytes) -> str:
        number, command, problem = read_line(raw, self._last)
        if number is not None and not problem and Fault.RESEND in self._told:
            self._told.discard(Fault.RESEND)
            problem = "checksum mismatch"
        if problem:
            return f"Error:{problem}, Last Line: {self._last}\nResend: {self._last + 1}\nok\n"
        if number is not None:
            self._last = number
        if not command:
            return "" if number is None else "ok\n"
        return self._execute(command)

    def _execute(self, command: str) -> str:
        code, parameters = words(command)
        if code == "M112":
            return "Error:Printer halted. kill() called!\n" + self._restart().decode()
        if code == "M105":
            return "ok T:21.3 /0.0 B:20.9 /0.0 T0:21.3 /0.0 @:0 B@:0\n"
        if code == "M118":
            return f"{command.partition(' ')[2]}\nok\n"
        if code in ("G90", "G91"):
            self._absolute = code == "G90"
        if code in ("G21", "G90", "G91", "M17", "M201", "M204"):  # of millimetres and constant speeds
            return "ok\n"
        doing = getattr(self, f"_{code.lower()}", None) if code[:1] in ("G", "M") and code[1:].isdigit() else None
        return f'echo:Unknown command: "{command}"\nok\n' if doing is None else f"{doing(parameters)}ok\n"

    # --- commands; each returns its output before its ok ---

    def _g1(self, parameters: Parameters) -> str:
        while self._head.queued >= _BUFFER:
            self._wait_until(self._head.next_end_s)
        speed = parameters.get("F")
        if speed is not None and speed > 0:
            self._speed_mm_s = speed / 60
        origin = self._target_mm()
        goals_mm = []
        for axis, now_mm in zip(_AXES, origin, strict=True):
            goal_mm = parameters.get(axis)
            if goal_mm is None:
                goals_mm.append(now_mm)
            else:
                goals_mm.append(goal_mm if self._absolute else now_mm + goal_mm)
        x, y, z = (min(max(goal_mm, 0.0), reach_mm) for goal_mm, reach_mm in zip(goals_mm, REACH_MM, strict=True))
        distances_mm = [abs(b - a) for a, b in zip(origin, (x, y, z), strict=True)]
        length = sum(way**2 for way in distances_mm) ** 0.5
        slowest_s = max(
            [length / self._speed_mm_s, *(w / v for w, v in zip(distances_mm, _FASTEST_MM_S, strict=True))]
        )
        if length > 0:
            true_x, true_y, true_z = (goal + offset for goal, offset in zip((x, y, z), self._offset, strict=True))
            self._head.go((true_x, true_y, true_z), length / slowest_s)
        return ""

    _g0 = _g1

    def _g4(self, parameters: Parameters) -> str:
        self._m400({})
        self._wait_until(self._rig.clock.now() + (parameters.get("S") or 0.0) + (parameters.get("P") or 0.0) / 1e3)
        return ""

    def _g28(self, parameters: Parameters) -> str:
        """Home the named axes, or all.

        A Prusa lifts first, and levels the mesh afterwards if no axis was named.
        """
        self._m400({})
        axes = [axis for axis, letter in enumerate(_AXES) if letter in parameters] or [0, 1, 2]
        x, y, z = self._head.target_mm
        if self._firmware == "prusa":
            self._head.go((x, y, z + _HOMING_LIFT_MM), _HOMING_MM_S[2])
        for axis in axes:
            goal = list(self._head.target_mm)
            goal[axis] = 0.0
            self._head.go((goal[0], goal[1], goal[2]), _HOMING_MM_S[axis])
        self._m400({})
        x, y, z = (0.0 if axis in axes else offset for axis, offset in enumerate(self._offset))
        self._offset = (x, y, z)
        if not any(letter in parameters for letter in (*_AXES, "W")) and self._firmware == "prusa":
            self._wait_until(self._rig.clock.now() + _LEVELLING_S)
        return ""

    def _m110(self, parameters: Parameters) -> str:
        self._last = int(parameters.get("N") or 0)
        return ""

    def _m114(self, parameters: Parameters) -> str:
        x, y, z = self._target_mm()
        live = [true - offset for true, offset in zip(self._head.position_mm, self._offset, strict=True)]
        if self._firmware == "prusa":
            count = f"Count X: {live[0]:.2f} Y:{live[1]:.2f} Z:{live[2]:.2f} E:0.00"
        else:
            steps = [round(mm * per_mm) for mm, per_mm in zip(live, self._steps, strict=True)]
            count = f"Count X:{steps[0]} Y:{steps[1]} Z:{steps[2]}"
        return f"X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00 {count}\n"

    def _m115(self, parameters: Parameters) -> str:
        return _FIRMWARE[self._firmware]

    def _m400(self, parameters: Parameters) -> str:
        self._wait_until(self._head.free_at_s)
        return ""

    def _m410(self, parameters: Parameters) -> str:
        self._head.stop()
        return ""

    # --- places and time ---

    def _target_mm(self) -> Position:
        x, y, z = (true - offset for true, offset in zip(self._head.target_mm, self._offset, strict=True))
        return x, y, z

    def _wait_until(self, time_s: float) -> None:
        """Wait, with a busy message every two seconds, sent at once: on a paced clock the driver waits as long."""
        while (left_s := time_s - self._rig.clock.now()) > 0:
            self._rig.clock.sleep(min(left_s, _BUSY_EVERY_S))
            if left_s > _BUSY_EVERY_S:
                self._send(_BUSY)
