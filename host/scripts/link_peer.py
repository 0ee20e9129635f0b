#!/usr/bin/env python3
"""The same load on thermokin's logger and on mosquitto with a logging subscriber, one after the other.

    link_peer.py [BOARDS [SECONDS]]     THERMOKIN=path/to/thermokin; 10000 boards and 20 seconds by default

Each board takes 10 records a second of 4 sensors and sends 10 records a second at a time. On mosquitto's side a message
of QoS 1 carries ten records as JSON, mosquitto_pub sends it over one of eight connections, and mosquitto_sub writes what
comes to a file. That is less work than the logger's: nothing is encrypted by board, nothing is synced before it is
acknowledged (the broker acknowledges what it has in memory), nothing is stored twice or once on purpose, no clock is
mapped. Needs mosquitto and mosquitto-clients (Debian's packages), and python3.
"""

import json
import os
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

RECORDS = 10
PUBLISHERS = 8


def cpu_s(pid):
    """Processor seconds of a process so far, in user mode and in the kernel."""
    with open(f"/proc/{pid}/stat") as file:
        fields = file.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def peak_mb(pid):
    """The most memory that a process had resident."""
    with open(f"/proc/{pid}/status") as file:
        return int(re.search(r"VmHWM:\s+(\d+)", file.read())[1]) / 1000


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def thermokin(boards, seconds, folder):
    """The virtual boards and the logger."""
    program = os.path.realpath(os.environ.get("THERMOKIN", "target/release/thermokin"))
    simulate = [program, "board", "virtual", "--registry", "boards.toml", "--count", str(boards)]
    quiet = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    subprocess.run([*simulate, "--duration", "0", "--drain", "0"], check=True, **quiet)
    host = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    logger = subprocess.Popen(
        [program, "log", "--plain", "--registry", "boards.toml", "--listen", host, "--json", "log.json"], **quiet
    )
    time.sleep(2)
    load = ["--rate", "10", "--batch", str(RECORDS), "--duration", str(seconds), "--drain", "120", "--host", host]
    subprocess.run([*simulate, *load, "--json", "boards.json"], check=True, **quiet)
    used, peak = cpu_s(logger.pid), peak_mb(logger.pid)
    logger.send_signal(signal.SIGINT)
    logger.wait()
    with open(os.path.join(folder, "boards.json")) as file:
        sent = json.load(file)
    with open(os.path.join(folder, "log.json")) as file:
        stored = json.load(file)["records"]
    return sent["taken"], stored, sent["slowest_s"], used, peak


def mosquitto(boards, seconds, folder):
    """Publishers, the broker and a subscriber that writes a file."""
    port = free_port(socket.SOCK_STREAM)
    with open(os.path.join(folder, "mosquitto.conf"), "w") as file:
        file.write(f"listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n")
        file.write(f"persistence true\npersistence_location {folder}/\nlog_type error\nuser root\n")
    server = shutil.which("mosquitto", path=os.environ["PATH"] + ":/usr/sbin")
    broker = subprocess.Popen([server, "-c", os.path.join(folder, "mosquitto.conf")], stderr=subprocess.DEVNULL)
    time.sleep(1)
    at = ["-h", "127.0.0.1", "-p", str(port), "-q", "1", "-t", "boards"]
    with open(os.path.join(folder, "log.txt"), "w") as file:
        subscriber = subprocess.Popen(["mosquitto_sub", *at, "-i", "logger", "-c", "-F", "%U %p"], stdout=file)
    time.sleep(1)
    publishers = [subprocess.Popen(["mosquitto_pub", *at, "-l"], stdin=subprocess.PIPE) for _ in range(PUBLISHERS)]
    draw = random.Random(1)
    counts = [[[draw.randrange(5000, 9000) for _ in range(4)] for _ in range(RECORDS)] for _ in range(64)]
    tails = [json.dumps(of_batch, separators=(",", ":")) + "}\n" for of_batch in counts]
    begin, batches = time.time(), 0
    while batches < boards * seconds:
        # The boards' batches are spread evenly over each second.
        due = min(boards * seconds, int((time.time() - begin) * boards))
        lines = [[] for _ in publishers]
        for number in range(batches, due):
            second, board = divmod(number, boards)
            head = f'{{"sent":{time.time():.6f},"board":{board},"sequence":{second * RECORDS},"counts":'
            lines[board % PUBLISHERS].append(head + tails[number % 64])
        for publisher, of_publisher in zip(publishers, lines):
            publisher.stdin.write("".join(of_publisher).encode())
            publisher.stdin.flush()
        batches = due
        time.sleep(0.01)
    for publisher in publishers:
        publisher.stdin.close()
        publisher.wait()
    # Until nothing more is written.
    path, size = os.path.join(folder, "log.txt"), -1
    while size != os.path.getsize(path):
        size = os.path.getsize(path)
        time.sleep(2)
    os.sync()
    used = cpu_s(broker.pid) + cpu_s(subscriber.pid)
    peak = peak_mb(broker.pid) + peak_mb(subscriber.pid)
    for process in (subscriber, broker):
        process.terminate()
        process.wait()
    seen, slowest = set(), 0.0
    with open(path) as file:
        for line in file:
            came, message = line.split(" ", 1)
            message = json.loads(message)
            seen.add((message["board"], message["sequence"]))
            slowest = max(slowest, float(came) - message["sent"])
    return batches * RECORDS, len(seen) * RECORDS, slowest, used, peak


def main():
    boards = int(sys.argv[1]) if len(sys.argv) > 1 else 10000
    seconds = int(sys.argv[2]) if len(sys.argv) > 2 else 20
    if not shutil.which("mosquitto", path=os.environ["PATH"] + ":/usr/sbin") or not shutil.which("mosquitto_sub"):
        sys.exit("link_peer.py: needs mosquitto: apt-get install mosquitto mosquitto-clients")
    print(f"{boards} boards, {seconds} s, load average before: {os.getloadavg()[0]:.2f}, {os.cpu_count()} cores")
    print("| | records taken | stored | slowest from taken or sent to stored, s | CPU, s per s | peak memory, MB |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, run in [("thermokin log", thermokin), ("mosquitto, mosquitto_sub", mosquitto)]:
        with tempfile.TemporaryDirectory(dir=os.environ.get("STORE_IN")) as folder:
            taken, stored, slowest, used, peak = run(boards, seconds, folder)
        print(f"| {name} | {taken} | {stored} | {slowest:.2f} | {used / seconds:.2f} | {peak:.0f} |", flush=True)


main()
