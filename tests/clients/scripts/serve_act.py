"""Serves plans at /act as MolmoAct2's server does, with json_numpy: plans.npz. Prints its port; ends with its input."""

import http.server
import json
import sys
import threading

import json_numpy
import numpy as np

PLANS = np.load(sys.argv[1])
ACTIONS = 30


class Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def do_POST(self):
        told = json_numpy.loads(self.rfile.read(int(self.headers["Content-Length"])))
        assert self.path == "/act"
        assert told["state"].shape == (14,) and told["state"].dtype == np.float32, told["state"]
        for name in ("top_cam", "left_cam", "right_cam"):
            assert told[name].shape == (224, 224, 3) and told[name].dtype == np.uint8, told[name].shape
            assert told[name].std() > 1
        assert isinstance(told["instruction"], str) and told["instruction"]
        assert told["num_steps"] == 10
        plan, now = PLANS[str(told["seed"])], round(told["time"] / 0.032)
        rows = plan[np.minimum(now + np.arange(ACTIONS), len(plan) - 1)]
        data = json_numpy.dumps({"actions": rows, "dt_ms": 32.0}).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format, *args):
        pass


with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
    threading.Thread(target=server.serve_forever, daemon=True).start()
    print(json.dumps({"port": server.server_address[1]}), flush=True)
    sys.stdin.read()
    server.shutdown()
