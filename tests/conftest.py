import signal
import threading

from hypothesis import settings

# The first call of a compiled loop takes seconds; a deadline would call that a failure.
settings.register_profile("compiled", deadline=None)
settings.load_profile("compiled")

# Where the tests run in the background or under nohup, these are ignored, and commands that the
# tests start would ignore them too.
if threading.current_thread() is threading.main_thread():
    for name, usual in (("SIGINT", signal.default_int_handler), ("SIGHUP", signal.SIG_DFL)):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, usual)
