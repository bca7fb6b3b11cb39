"""HAL pins, signals and parameters by name, from the system's Python."""

import subprocess

import hal

HALCMD_WITHIN_S = 2.0


class NoSuchPinError(Exception):
    """HAL has no such name, or it cannot be set to that."""


class HalPins:
    """Needs a component of this process in HAL."""

    def get(self, name):
        """bit as bool, s32 and u32 as int, float as float."""
        try:
            return hal.get_value(name)
        except (RuntimeError, TypeError) as error:
            raise NoSuchPinError(f"HAL has no pin, signal or parameter {name}") from error

    def values(self, *names):
        return [self.get(name) for name in names]

    def set(self, name, value):
        """A pin that nothing drives (`setp`), or the signal it is linked to where nothing writes that (`sets`)."""
        self.get(name)
        text = str(int(value)) if isinstance(value, bool) else repr(value)
        signal = self._signal(name)
        if signal is not None:
            return self._sets(signal, text)
        try:
            hal.set_p(name, text)
        except (RuntimeError, TypeError) as error:
            raise NoSuchPinError(f"{name} cannot be set to {text}: {error}") from error
        return None

    def _signal(self, name):
        """The signal that pin `name` is linked to, or the signal of that name itself."""
        if any(signal["NAME"] == name for signal in hal.get_info_signals()):
            return name
        for line in self._halcmd("-s", "show", "pin", name).splitlines():
            words = line.split()
            if len(words) == 7 and words[4] == name:
                return words[6]
        return None

    def _sets(self, signal, text):
        self._halcmd("-s", "sets", signal, text)

    def _halcmd(self, *words):
        done = subprocess.run(  # noqa: S603  fixed program, no shell
            ["/usr/bin/halcmd", *words], capture_output=True, text=True, timeout=HALCMD_WITHIN_S, check=False
        )
        if done.returncode != 0:
            raise NoSuchPinError((done.stderr or done.stdout).strip() or f"halcmd {' '.join(words)} failed")
        return done.stdout
