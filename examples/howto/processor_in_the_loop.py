"""
The compiled controller in the loop
===================================

The compiled controller in a process of its own, the plant in this one, UDP between them.

The car follower under a designed law. Every period the plant sends what it measures to the
controller, which is the C that ``export_c`` writes behind a socket, and applies what comes back,
when it comes back. Packets with measurements are lost, answers are lost, some come twice, time
stamps are off by up to 0.4 periods, and inputs are applied up to 0.4 periods late. What one
learns: with the time stamps and the inputs as applied, the controller keeps its predictions right
through all of it, and the loop stays stable.
"""

import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.numerics.exponential import discretise

SERVER = """
#define _POSIX_C_SOURCE 200112L
#include <arpa/inet.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include "controller.h"
#define N CONTROLLER_STATES
#define M CONTROLLER_INPUTS
/* Requests: number (below 0: stop), time, mode, whether applied is given, x, applied.
   Answers: number, status, nanoseconds of the step, u. */
int main(void)
{
    static controller_controller c;
    double in[4 + N + M], out[3 + M];
    struct sockaddr_in me, from;
    socklen_t size = sizeof me;
    struct timeval patience = {20, 0};
    int s = socket(AF_INET, SOCK_DGRAM, 0);
    memset(&me, 0, sizeof me);
    me.sin_family = AF_INET;
    me.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (s < 0 || bind(s, (struct sockaddr *)&me, sizeof me) != 0
        || getsockname(s, (struct sockaddr *)&me, &size) != 0
        || setsockopt(s, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience) != 0) {
        return 1;
    }
    printf("%d\\n", (int)ntohs(me.sin_port));
    fflush(stdout);
    (void)controller_reset(&c, 0, 0);
    for (;;) {
        struct timespec a, b;
        size = sizeof from;
        if (recvfrom(s, in, sizeof in, 0, (struct sockaddr *)&from, &size) != (long)sizeof in) {
            return 2;
        }
        if (in[0] < 0.0) {
            return 0;
        }
        clock_gettime(CLOCK_MONOTONIC, &a);
        out[1] = (double)controller_update(&c, in + 4, (int)in[2], in[3] > 0.0 ? in + 4 + N : 0,
                                           in + 1, out + 3);
        clock_gettime(CLOCK_MONOTONIC, &b);
        out[0] = in[0];
        out[2] = 1e9 * (double)(b.tv_sec - a.tv_sec) + (double)(b.tv_nsec - a.tv_nsec);
        (void)sendto(s, out, sizeof out, 0, (struct sockaddr *)&from, size);
    }
}
"""
STATUS = {0: "in order", 1: "saturated", 7: "late", 8: "out of order"}

command = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
if command is None:
    sys.exit("This example compiles C: it needs cc, gcc or clang.")
problem = dt.problems.follower()
plant, step, horizon = problem.plant, problem.step, 30.0
law, x0 = problem.laws["averaged"], np.array(problem.x0)
signal = dt.SwitchingSignal.random(plant.modes, horizon + 5.0, dwell_time=1.0, seed=3)
rng, steps = np.random.default_rng(0), round(horizon / step)

with tempfile.TemporaryDirectory() as place:
    folder = Path(place)
    print(dt.Controller(law, step).export_c(folder).check.message)
    (folder / "server.c").write_text(SERVER, encoding="utf-8")
    sources = [str(folder / "controller.c"), str(folder / "server.c")]
    subprocess.run([command, "-O2", *sources, "-o", str(folder / "server")], check=True)
    server = subprocess.Popen([str(folder / "server")], stdout=subprocess.PIPE, text=True)
    wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    wire.settimeout(2.0)
    address = ("127.0.0.1", int(server.stdout.readline()))

    def ask(number, when, mode, x, applied):
        """One packet there and back."""
        began = time.perf_counter_ns()
        reported = applied if applied is not None else np.zeros(plant.inputs)
        request = np.concatenate(([number, when, mode, applied is not None], x, reported))
        wire.sendto(request.tobytes(), address)
        answer = np.frombuffer(wire.recv(1024))
        assert answer[0] == number
        return answer[3:], int(answer[1]), answer[2], time.perf_counter_ns() - began

    # What the actuator does from when on; the plant sees it a delay later.
    since, inputs = [-10.0 * plant.delay], [np.zeros(plant.inputs)]
    x, states, seen, nanoseconds, trips, lost = x0.copy(), [x0], Counter(), [], [], Counter()
    for k in range(steps):
        now, applied = k * step, inputs[-1]
        stamp = now + rng.uniform(-0.4, 0.4) * step * (k > 0)
        if k and rng.random() < 0.03:
            lost["measurements lost"] += 1
        else:
            u, status, own, trip = ask(k, stamp, int(signal(now)), x, applied if k else None)
            seen[STATUS.get(status, status)] += 1
            nanoseconds.append(own)
            trips.append(trip)
            if rng.random() < 0.02:
                again, status, *_ = ask(k, stamp, int(signal(now)), 2.0 * x, applied)
                seen[STATUS.get(status, status)] += 1
                assert (again == u).all()
            if rng.random() < 0.03:
                lost["answers lost"] += 1
            else:
                since.append(now + rng.uniform(0.0, 0.4) * step)
                inputs.append(u)
        # The plant over the period: cut where an input arrives and where it switches.
        arrivals = np.array(since) + plant.delay
        cuts = np.concatenate((arrivals, signal.times))
        inside = cuts[(cuts > now) & (cuts < now + step)]
        edges = np.unique(np.concatenate(([now], inside, [now + step])))
        for a, b in pairwise(edges):
            mode = int(signal(a))
            Phi, Gamma = discretise(plant.A[mode], plant.B[mode], b - a)
            x = Phi @ x + Gamma @ inputs[np.searchsorted(arrivals, a, side="right") - 1]
        states.append(x)
    wire.sendto(np.full(4 + plant.states + plant.inputs, -1.0).tobytes(), address)
    assert server.wait(timeout=10) == 0
    server.stdout.close()
    wire.close()

states, times = np.array(states).T, step * np.arange(steps + 1)
plain = dt.simulate(plant, law, signal, x0, horizon, step)
norms = {"over UDP": np.linalg.norm(states, axis=0)}
norms["without a network"] = np.linalg.norm(plain.states, axis=0)
peak, final = norms["over UDP"].max(), norms["over UDP"][-100:].max()
print(f"{steps} periods of {step} s: {dict(lost)}; statuses {dict(seen)}")
print(
    f"|x| peaks at {peak:.2f}, ends below {final:.1e}: {'stable' if final < 0.05 * peak else '?'}"
)
print(f"step of the law: median {np.median(nanoseconds):.0f} ns, with the clock's own time")
middle, tail = np.quantile(trips, (0.5, 0.99)) / 1e3
print(f"there and back: median {middle:.0f} µs, 99 % {tail:.0f} µs")

figure = Figure(figsize=(8, 7), layout="constrained")
top, bottom = figure.subplots(2)
for name, norm in norms.items():
    top.semilogy(times, np.maximum(norm, 1e-12), label=name)
top.set(xlabel="time, s", ylabel="|x|", title="Car follower, averaged law, switching at random")
top.legend()
bottom.hist(np.array(trips) / 1e3, bins=np.geomspace(min(trips), max(trips), 60) / 1e3)
bottom.set(xscale="log", xlabel="there and back, µs", ylabel="packets")
figure.savefig("processor_in_the_loop.png", dpi=110)
