"""Limits of the simulation that are known in closed form: `simulate.py check`."""

import unittest
from dataclasses import replace

import measure
import refusals
import simulate as s

FAST = replace(s.Parameters(), threads=1, network=1e18, connection=1e18, latency=0.0, prefix_rate=1e18, dispatch=0.0)
"""A bucket and a network that cost nothing."""


def work(workers, chunks, cpu=0.01, pages=10.0, requests=5.0, size=1e6):
    return [[(cpu, pages, requests, size)] * chunks for _ in range(workers)]


class Limits(unittest.TestCase):
    def test_one_worker_with_free_reads_takes_the_sum_of_its_costs(self):
        (done,), _, _ = s.run(work(1, 100), FAST, 64)
        self.assertAlmostEqual(done, 1.0)

    def test_threads_divide_it(self):
        (done,), _, _ = s.run(work(1, 100), replace(FAST, threads=4), 64)
        self.assertAlmostEqual(done, 0.25)

    def test_with_free_reads_the_slowest_worker_decides(self):
        jobs = work(3, 10) + work(1, 25)
        self.assertAlmostEqual(max(s.run(jobs, FAST, 64)[0]), 0.25)

    def test_a_full_bucket_takes_requests_over_rate(self):
        p = replace(FAST, prefix_rate=1000.0)
        done, requests, _ = s.run(work(50, 20, cpu=0.0), p, 1e9)
        self.assertEqual(requests, 5000)
        self.assertAlmostEqual(max(done), 5.0, delta=0.01)

    def test_prefixes_multiply_the_rate(self):
        p = replace(FAST, prefix_rate=1000.0, prefixes=10)
        self.assertAlmostEqual(max(s.run(work(50, 20, cpu=0.0), p, 1e9)[0]), 0.5, delta=0.01)

    def test_a_full_network_takes_bytes_over_its_rate(self):
        done, _, size = s.run(work(2, 20, cpu=0.0), replace(FAST, network=1e6), 1e9)
        self.assertEqual(size, 40e6)
        self.assertAlmostEqual(max(done), 20.0, delta=0.01)

    def test_requests_in_flight_bound_a_worker(self):
        p = replace(FAST, latency=0.05, jitter=0.0, in_flight=64)
        (done,), _, _ = s.run(work(1, 256, cpu=0.0, requests=64.0), p, 1e9)
        self.assertAlmostEqual(done, 256 * 0.05, delta=0.15)

    def test_a_window_of_one_chunk_waits_for_every_read(self):
        p = replace(FAST, latency=0.05, jitter=0.0)
        (done,), _, _ = s.run(work(1, 20, cpu=0.01, requests=1.0), p, 10)
        self.assertAlmostEqual(done, 20 * 0.06, delta=0.05)

    def test_a_wide_window_hides_latency(self):
        p = replace(FAST, latency=0.05, jitter=0.0)
        (done,), _, _ = s.run(work(1, 200, cpu=0.01, requests=1.0), p, 1000)
        self.assertAlmostEqual(done, 2.05, delta=0.05)

    def test_nothing_is_refused_below_the_rate(self):
        self.assertEqual(refusals.stubborn(1, s.Parameters(), seconds=5.0), 0.0)
        row = refusals.paced(1, s.Parameters(), seconds=5.0)
        self.assertEqual(row["refused_a_request"], 0.0)
        self.assertAlmostEqual(row["served_s"], 64 / 0.05, delta=64)

    def test_the_rate_is_served_and_no_more(self):
        served = refusals.paced(64, s.Parameters(), seconds=5.0)["served_s"]
        self.assertTrue(0.9 * 5500 < served < 1.05 * 5500, served)

    def test_workers_that_heed_refusals_give_up_nothing(self):
        p = s.Parameters()
        row = refusals.paced(256, p, seconds=10.0)
        self.assertLess(row["refused_a_request"], 2.0)
        self.assertGreater(refusals.stubborn(256, p, seconds=10.0), 0.2)


class Dealing(unittest.TestCase):
    def test_every_block_is_dealt_once_and_shares_are_about_equal(self):
        for columns, rows, of in ((1, 1, 1), (22, 9, 7), (240, 135, 1024), (60, 34, 3)):
            shares = s.dealt(columns, rows, of)
            blocks = [block for share in shares for block in share]
            self.assertEqual(sorted(blocks), sorted((i, j) for i in range(columns) for j in range(rows)))
            self.assertLessEqual(max(map(len, shares)) - min(map(len, shares)), 8)

    def test_the_curve_goes_from_neighbour_to_neighbour(self):
        cells = list(s.hilbert_cells(16, 16))
        self.assertTrue(all(abs(a - c) + abs(b - d) == 1 for (a, b), (c, d) in zip(cells, cells[1:])))


class Pages(unittest.TestCase):
    def test_neighbouring_reads_share_a_request_up_to_a_mebibyte(self):
        self.assertEqual(measure.joined([0, 1, 2], 32768), (1, 3 * 32768))
        self.assertEqual(measure.joined([0, 3], 32768), (1, 4 * 32768))
        self.assertEqual(measure.joined([0, 4], 32768), (2, 2 * 32768))
        self.assertEqual(measure.joined(range(64), 32768)[0], 2)
        self.assertEqual(measure.joined([], 32768), (0, 0))

    def test_least_recent_use(self):
        frames = [[[1, 2, 3]], [[1, 2, 3]]]
        self.assertEqual(measure.lru(frames, 3), [3, 0])
        self.assertEqual(measure.lru(frames, 2), [3, 3])

    def test_blocks_that_share_nothing_are_read_whole_and_those_that_share_all_once(self):
        blocks = list(s.hilbert_cells(4, 4))
        picture = s.Picture(4, 4, {}, {b: 100.0 for b in blocks}, 0.0, (1.0, 1.0), 1.0)
        self.assertAlmostEqual(sum(c[1] for c in s.chunks(picture, blocks, 1e9, 0.0)), 1600)
        picture.shared = 1.0
        self.assertAlmostEqual(sum(c[1] for c in s.chunks(picture, blocks, 1e9, 0.0)), 100)
        # Where nothing fits, nothing is shared.
        self.assertAlmostEqual(sum(c[1] for c in s.chunks(picture, blocks, -1.0, 0.0)), 1600)

    def test_calibration_finds_what_one_worker_reads(self):
        blocks = list(s.hilbert_cells(16, 16))
        picture = s.Picture(16, 16, {}, {b: 100.0 for b in blocks}, 0.0, (1.0, 1.0), 1.0)
        picture.shared = s.calibrated(picture, 10000.0)
        self.assertAlmostEqual(sum(c[1] for c in s.chunks(picture, blocks, 1e18, 0.0)), 10000.0, delta=50)
