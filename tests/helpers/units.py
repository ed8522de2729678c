"""FMI 2.0 units in FMPy, for tests of the export."""

import contextlib
import tempfile

import pytest

fmpy = pytest.importorskip("fmpy")
fmi2 = pytest.importorskip("fmpy.fmi2")


class Instance:
    """Instance of a unit with its log `said`; it is initialised unless `begun` is false."""

    def __init__(self, file, parameters=None, begun=True):
        description = fmpy.read_model_description(str(file))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.said, self.time = [], 0.0
        identifier = description.coSimulation.modelIdentifier
        with tempfile.TemporaryDirectory() as folder:  # a loaded library no longer needs its file
            made = {"guid": description.guid, "unzipDirectory": fmpy.extract(str(file), folder)}
            self.slave = fmi2.FMU2Slave("unit", modelIdentifier=identifier, **made)
        self.slave.instantiate(callbacks=self._callbacks())
        if begun:
            self.begin(parameters)

    def begin(self, parameters=None, **experiment):
        self.slave.setupExperiment(**experiment)
        self.set(list(parameters or {}), list((parameters or {}).values()))
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def _callbacks(self):
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *a: self.said.append(a[4].decode()))
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        return callbacks

    @contextlib.contextmanager
    def refused(self):
        """Context manager that expects one call with an error and one entry in the log; yields the log."""
        self.said.clear()
        with pytest.raises(fmpy.fmi1.FMICallException) as raised:
            yield self.said
        assert raised.value.status == fmi2.fmi2Error and len(self.said) == 1

    def get(self, names):
        return self.slave.getReal([self.references[name] for name in names])

    def count(self, name):
        return self.slave.getInteger([self.references[name]])[0]

    def set(self, names, values):
        self.slave.setReal([self.references[name] for name in names], values)

    def step(self, length=0.001):
        self.slave.doStep(currentCommunicationPoint=self.time, communicationStepSize=length)
        self.time += length
