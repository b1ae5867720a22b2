"""Requests beyond the rate of a bucket, which refuses them (503), one by one: by workers that heed it, and by those that do not.

Parameters are those of `simulate.py`.
"""

import heapq
import random


def flight_time(p, size):
    """Seconds of a request of so many bytes."""
    return max(p.latency + size / p.connection, p.in_flight * size / p.network)


class Limit:
    """What a bucket answers, and what it refuses (503): requests beyond its rate, of which a tenth of a second's may come at once."""

    def __init__(self, rate):
        self.rate, self.tokens, self.filled = rate, rate / 10, 0.0

    def admits(self, now):
        self.tokens, self.filled = min(self.rate / 10, self.tokens + (now - self.filled) * self.rate), now
        admitted = self.tokens >= 1
        self.tokens -= admitted
        return admitted


def stubborn(workers, p, seconds=20.0, seed=1, size=0.0):
    """The share of the requests that are given up, if every worker keeps all of its requests in flight, tries again after a pause that
    doubles, and counts refusals as failures. Every request is followed."""
    randoms, limit, flight = random.Random(seed), Limit(p.prefix_rate * p.prefixes), flight_time(p, size)
    served = lost = 0
    events = [(randoms.random() * p.latency, i, 0) for i in range(workers * p.in_flight)]
    heapq.heapify(events)
    serial = len(events)
    while events and events[0][0] < seconds:
        now, _, failures = heapq.heappop(events)
        if limit.admits(now):
            served += 1
            after, failures = flight * (1 + p.jitter * (2 * randoms.random() - 1)), 0
        else:
            failures += 1
            if failures == p.attempts:
                lost += 1
                failures = 0
            pause = min(p.longest_pause, p.first_pause * 2 ** max(0, failures - 1)) if failures else 0.0
            after = p.latency / 2 + pause * (0.75 + 0.5 * randoms.random())
        serial += 1
        heapq.heappush(events, (now + after, serial, failures))
    return lost / max(1, served + lost)


class Pace:
    """How many requests a worker has in flight (crates/rayset-store/src/storage/remote/pace.rs)."""

    def __init__(self, p):
        self.p, self.allowed, self.heeded, self.quiet_until, self.in_a_row = p, float(p.in_flight), -1.0, 0.0, 0
        self.flying, self.again = 0, []

    def answered(self):
        self.allowed = min(self.p.in_flight, self.allowed + 1 / self.allowed)
        self.in_a_row = 0

    def refused(self, begun, now, shake):
        """Returns whether nothing is begun for a while from now on."""
        if begun < self.heeded:
            return False
        self.allowed, self.heeded, self.in_a_row = max(1.0, self.allowed * self.p.decrease), now, self.in_a_row + 1
        self.quiet_until = now + min(self.p.longest_quiet, self.p.first_pause * 2 ** (self.in_a_row - 1)) * shake
        return True


def paced(workers, p, seconds=20.0, seed=1, size=0.0):
    """Requests to a bucket beyond its rate, by workers that send fewer at a time after a refusal. Every request is followed."""
    randoms, limit, flight = random.Random(seed), Limit(p.prefix_rate * p.prefixes), flight_time(p, size)
    paces = [Pace(p) for _ in range(workers)]
    served = refused = serial = 0
    longest, events = 0.0, []

    def push(at, kind, pace, *rest):
        nonlocal serial
        serial += 1
        heapq.heappush(events, (at, serial, kind, pace, *rest))

    def start(pace, now):
        while now >= pace.quiet_until and pace.flying < int(pace.allowed):
            since = heapq.heappop(pace.again) if pace.again else now
            pace.flying += 1
            push(now + p.latency / 2 * (1 + p.jitter * (2 * randoms.random() - 1)), "arrives", pace, since, now)

    for pace in paces:
        push(randoms.random() * p.latency, "starts", pace)
    while events and events[0][0] < seconds:
        now, _, kind, pace, *request = heapq.heappop(events)
        if kind == "arrives":
            if limit.admits(now):
                push(now + (flight - p.latency / 2) * (1 + p.jitter * (2 * randoms.random() - 1)), "served", pace, *request)
            else:
                push(now + p.latency / 2, "refused", pace, *request)
            continue
        if kind != "starts":
            since, begun = request
            pace.flying -= 1
            longest = max(longest, now - since)
            if kind == "served":
                served += 1
                pace.answered()
            else:
                refused += 1
                heapq.heappush(pace.again, since)
                if pace.refused(begun, now, 0.75 + 0.5 * randoms.random()):
                    push(pace.quiet_until, "starts", pace)
        start(pace, now)
    return {"served_s": served / seconds, "refused_a_request": refused / max(1, served), "longest_s": longest}
