"""A unit of FMI 2.0 in FMPy, for the tests of what is exported."""

import pytest

fmpy = pytest.importorskip("fmpy")
fmi2 = pytest.importorskip("fmpy.fmi2")


class Instance:
    """One instance with what it logs."""

    def __init__(self, file, name="unit", guid=None, parameters=None):
        description = fmpy.read_model_description(str(file))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.said, self.time = [], 0.0
        own = {"instanceName": name, "modelIdentifier": description.coSimulation.modelIdentifier}
        own |= {"guid": guid or description.guid, "unzipDirectory": fmpy.extract(str(file))}
        self.slave = fmi2.FMU2Slave(**own)
        self._get, self._set = self.slave.getReal, self.slave.setReal
        self.slave.instantiate(callbacks=self._callbacks())
        self.set(list(parameters or {}), list((parameters or {}).values()))
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def _callbacks(self):
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *a: self.said.append(a[4].decode()))
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        return callbacks

    def get(self, names):
        return self._get([self.references[name] for name in names])

    def set(self, names, values):
        self._set([self.references[name] for name in names], values)

    def step(self, length=0.001):
        self.slave.doStep(currentCommunicationPoint=self.time, communicationStepSize=length)
        self.time += length
