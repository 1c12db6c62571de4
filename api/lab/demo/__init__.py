"""The demonstration drill: service and simulated fleet as a user would run them, one UAV lost, everything checked.

`runner.py` flies it, `client.py` talks REST to the service process, `truth.py` judges by the simulator's ground truth,
`report.py` is what comes out, `page.py` draws it.
"""

from skyfolio.api.lab.demo.client import DemoError
from skyfolio.api.lab.demo.orders import DemoConfig
from skyfolio.api.lab.demo.report import DemoReport
from skyfolio.api.lab.demo.runner import run_demo

__all__ = ["DemoConfig", "DemoError", "DemoReport", "run_demo"]
