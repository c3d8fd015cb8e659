"""Hosts that hang on one Ethernet switch, which is this process: `python -S switch.py HOST …`.

Each host is a process with a network, mounts and a name of its own, with nothing in its /dev/shm,
and with one interface: a TAP whose other end is here. All of it ends with this process, and this
process with its standard input.

It prints the process number of each host, then takes commands, a line each, and answers each with
a line:

    seed 1              of what is random from now on
    loss 0.1            share of the frames that are lost
    delay 0.01 0.03     range [s] from which the delay of each frame is drawn: they overtake
    multicast off       frames to a group are not forwarded
    link encoder off    a host's cable is pulled; `on` puts it back
    counts              of frames, and the length of the longest one [byte], as JSON
"""

import ctypes
import fcntl
import heapq
import itertools
import json
import os
import random
import select
import signal
import socket
import struct
import subprocess
import sys
import time

FLAGS = 0x20000 | 0x4000000 | 0x40000000  # CLONE_NEWNS, CLONE_NEWUTS, CLONE_NEWNET
PR_SET_PDEATHSIG = 1
TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
BROADCAST = b'\xff' * 6
FRAME = 2048  # byte that the longest one has at most
BATCH = 64  # frames that are taken from one host before the next one has its turn
SET_UP = (
    'mount --make-rprivate /',
    'mount -t tmpfs tmpfs /dev/shm',
    'ip link set lo up',
    'ip link set eth0 txqueuelen 10000 up',
    'ip address add {address}/24 dev eth0',
    'ip route add 224.0.0.0/4 dev eth0',
)


def call(name, *arguments):
    """Call a function of the C library."""
    if getattr(_libc, name)(*arguments):
        number = ctypes.get_errno()
        raise OSError(number, f'{name}: {os.strerror(number)}')


_libc = ctypes.CDLL(None, use_errno=True)


def start_host(name, number):
    """Return the process number of a new host, and the other end of its interface."""
    ours, its = socket.socketpair()
    switch = os.getpid()
    process = os.fork()
    if process:
        its.close()
        _, (tap,), _, _ = socket.recv_fds(ours, 1, 1)
        os.set_blocking(tap, False)
        return process, tap
    try:
        call('prctl', PR_SET_PDEATHSIG, signal.SIGKILL)
        call('unshare', FLAGS)
        socket.sethostname(name)
        tap = os.open('/dev/net/tun', os.O_RDWR)
        fcntl.ioctl(tap, TUNSETIFF, struct.pack('16sH22x', b'eth0', IFF_TAP | IFF_NO_PI))
        for command in SET_UP:
            subprocess.run(command.format(address=f'10.0.0.{number}').split(), check=True)
        socket.send_fds(its, [b'.'], [tap])
        os.close(tap)
        while os.getppid() == switch:
            signal.pause()
    finally:
        os._exit(1)


class Switch:
    """Forwards frames between hosts, as far as they get.

    Args:
        taps: the other end of each host's interface, by name.
    """

    def __init__(self, taps):
        self.taps = taps
        self.down = set()
        self.loss = 0.0
        self.delay = 0.0, 0.0
        self.multicast = True
        self.counts = {'sent': dict.fromkeys(taps, 0)}  # byte
        self.counts |= dict.fromkeys(('lost', 'overtaken', 'multicast', 'longest'), 0)
        self._random = random.Random(0)
        self._known = {}  # host by address
        self._on_their_way = []
        self._number = itertools.count()
        self._delivered = dict.fromkeys(itertools.permutations(taps, 2), -1)  # newest, by way

    def run(self):
        hosts = {tap: name for name, tap in self.taps.items()}
        while True:
            first = self._on_their_way[0][0] - time.monotonic() if self._on_their_way else None
            ready, _, _ = select.select([0, *hosts], [], [], first and max(first, 0.0))
            for descriptor in ready:
                if descriptor != 0:
                    self._take_frames(hosts[descriptor])
                elif not self._obey(sys.stdin.readline().split()):
                    return
            while self._on_their_way and self._on_their_way[0][0] <= time.monotonic():
                self._deliver(*heapq.heappop(self._on_their_way)[1:])

    def _take_frames(self, source):
        for _ in range(BATCH):
            try:
                frame = os.read(self.taps[source], FRAME)
            except BlockingIOError:
                return
            self.counts['sent'][source] += len(frame)
            self.counts['longest'] = max(self.counts['longest'], len(frame))
            destination = frame[:6]
            self._known[frame[6:12]] = source
            if destination[0] & 1 and destination != BROADCAST:
                self.counts['multicast'] += 1
                if not self.multicast:
                    continue
            host = self._known.get(destination)
            for target in [host] if host else self.taps:
                if target != source:
                    self._send(source, target, frame)

    def _send(self, source, target, frame):
        if self.down & {source, target} or self._random.random() < self.loss:
            self.counts['lost'] += 1
            return
        number = next(self._number)
        shortest, longest = self.delay
        if longest:
            due = time.monotonic() + self._random.uniform(shortest, longest)
            heapq.heappush(self._on_their_way, (due, number, source, target, frame))
        else:
            self._deliver(number, source, target, frame)

    def _deliver(self, number, source, target, frame):
        self.counts['overtaken'] += number < self._delivered[source, target]
        self._delivered[source, target] = max(number, self._delivered[source, target])
        os.write(self.taps[target], frame)

    def _obey(self, words):
        """Carry out a command; return whether there was one."""
        answer = 'ok'
        match words:
            case ['seed', number]:
                self._random.seed(int(number))
            case ['loss', share]:
                self.loss = float(share)
            case ['delay', shortest, longest]:
                self.delay = float(shortest), float(longest)
            case ['multicast', state]:
                self.multicast = state == 'on'
            case ['link', host, state]:
                (self.down.discard if state == 'on' else self.down.add)(host)
            case ['counts']:
                answer = json.dumps(self.counts)
            case _:
                return False
        print(answer, flush=True)
        return True


def main(names):
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is for the tests, which end this
    hosts = {name: start_host(name, number) for number, name in enumerate(names, start=1)}
    print(json.dumps({name: process for name, (process, _) in hosts.items()}), flush=True)
    Switch({name: tap for name, (_, tap) in hosts.items()}).run()


if __name__ == '__main__':
    main(sys.argv[1:])
