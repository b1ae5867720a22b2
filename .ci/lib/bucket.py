"""A bucket on this machine, by a server that speaks S3's protocol, with a proxy in front of it, and the program that uses it.

Needs the packages moto[s3,server] and boto3.
"""
import hashlib
import logging
import os
import pathlib
import subprocess

import boto3
from moto.server import ThreadedMotoServer

from faulty_proxy import Proxy

BUCKET = "bucket"


def digest(path):
    return hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest()


class Bucket:
    """The bucket `bucket`, empty."""

    def __init__(self):
        logging.getLogger("werkzeug").setLevel(logging.CRITICAL)
        self.server = ThreadedMotoServer(port=0)
        self.server.start()
        host, port = self.server.get_host_and_port()
        self.proxy = Proxy("127.0.0.1" if host == "0.0.0.0" else host, port)
        credentials = {"aws_access_key_id": "test", "aws_secret_access_key": "test", "region_name": "us-east-1"}
        self.s3 = boto3.client("s3", endpoint_url=f"http://{host}:{port}", **credentials)
        self.s3.create_bucket(Bucket=BUCKET)
        self.environment = {key: value for key, value in os.environ.items() if not key.startswith(("AWS_", "RAYSET_"))}
        self.environment |= {
            "AWS_ENDPOINT_URL": self.proxy.address,
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_REGION": "us-east-1",
        }

    def objects(self):
        return sorted(found["Key"] for found in self.s3.list_objects_v2(Bucket=BUCKET).get("Contents", []))

    def uploads(self):
        return self.s3.list_multipart_uploads(Bucket=BUCKET).get("Uploads", [])

    def notes(self):
        """Objects that are there only while something is under way."""
        return [key for key in self.objects() if key.endswith(".rayset-upload")]

    def digest(self, key):
        return hashlib.sha256(self.s3.get_object(Bucket=BUCKET, Key=key)["Body"].read()).hexdigest()

    def put(self, key, bytes_):
        self.s3.put_object(Bucket=BUCKET, Key=key, Body=bytes_)

    def upload(self, path, key):
        self.s3.upload_file(str(path), BUCKET, key)

    def remove(self, key):
        self.s3.delete_object(Bucket=BUCKET, Key=key)

    def stop(self):
        self.server.stop()


class Program:
    """A program, and the environment in which it is run."""

    def __init__(self, path, environment):
        self.path, self.environment = pathlib.Path(path).resolve(), dict(environment)

    def run(self, *words, fails=False, **more):
        """What it says. It is to succeed, or to fail."""
        done = subprocess.run([self.path, *map(str, words)], capture_output=True, text=True, env=self.environment | more)
        assert (done.returncode != 0) == fails, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout + done.stderr

    def start(self, *words, **more):
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen([self.path, *map(str, words)], env=self.environment | more, **pipes)
