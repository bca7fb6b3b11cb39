// Browse from Objects/Machines to the first machine, and print what a client finds that knows OPC 40001 and OPC 40501-1.
// Arguments: URL, PKI directory, certificate and key (PEM), application URI, password.
const opcua = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");

const [url, pki, certificateFile, privateKeyFile, applicationUri, password] = process.argv.slice(2);
const MACHINERY = "http://opcfoundation.org/UA/Machinery/";
const MACHINE_TOOL = "http://opcfoundation.org/UA/MachineTool/";
const DI = "http://opcfoundation.org/UA/DI/";
const RESULT = "http://opcfoundation.org/UA/Machinery/Result/";

async function main() {
    const clientCertificateManager = new OPCUACertificateManager({
        rootFolder: pki, automaticallyAcceptUnknownCertificate: true,
    });
    await clientCertificateManager.initialize();
    const client = opcua.OPCUAClient.create({
        applicationUri, certificateFile, privateKeyFile, clientCertificateManager, endpointMustExist: false,
        securityMode: opcua.MessageSecurityMode.SignAndEncrypt,
        securityPolicy: opcua.SecurityPolicy.Basic256Sha256,
        connectionStrategy: { maxRetry: 1 },
    });
    await client.connect(url);
    const session = await client.createSession({ type: opcua.UserTokenType.UserName, userName: "mes", password });
    const uris = await session.readNamespaceArray();
    const index = (uri) => uris.indexOf(uri);
    const own = index("urn:volcal:opcua:1");

    async function references(nodeId, resultMask = 63) {
        const found = await session.browse({
            nodeId, resultMask, referenceTypeId: "HierarchicalReferences", includeSubtypes: true,
            browseDirection: opcua.BrowseDirection.Forward,
        });
        return found.references;
    }
    async function child(nodeId, ...path) {  // path of [namespace index, name]
        for (const [namespaceIndex, name] of path) {
            const all = await references(nodeId);
            const one = all.find((r) => r.browseName.namespaceIndex === namespaceIndex && r.browseName.name === name);
            if (!one) throw new Error(`${name} is not below ${nodeId}`);
            nodeId = one.nodeId;
        }
        return nodeId;
    }
    async function typeOf(nodeId) {
        const found = await session.browse({
            nodeId, referenceTypeId: "HasTypeDefinition", browseDirection: opcua.BrowseDirection.Forward, resultMask: 63,
        });
        const { nodeId: type, browseName } = found.references[0];
        return [uris[type.namespace], type.value, browseName.name];
    }
    async function value(nodeId) {
        const read = await session.read({ nodeId, attributeId: opcua.AttributeIds.Value });
        const found = read.value.value;
        return read.statusCode.isGood() ? (found && found.text !== undefined ? found.text : found) : read.statusCode.name;
    }

    const machines = await child("i=85", [index(MACHINERY), "Machines"]);
    const [machine] = await references(machines);
    const id = machine.nodeId;
    const identification = await child(id, [index(DI), "Identification"]);
    const program = await child(id, [index(MACHINE_TOOL), "Production"], [index(MACHINE_TOOL), "ActiveProgram"]);
    const blocks = await child(id, [index(MACHINERY), "MachineryBuildingBlocks"]);
    const last = await child(
        blocks, [index(RESULT), "ResultManagement"], [index(RESULT), "Results"], [own, "LastCalibration"]);
    const meta = await child(last, [index(RESULT), "ResultMetaData"]);
    const state = await child(program, [index(MACHINE_TOOL), "State"]);
    const item = await child(blocks, [index(MACHINERY), "MachineryItemState"]);
    console.log(JSON.stringify({
        name: machine.browseName.name,
        types: {
            machine: await typeOf(id),
            identification: await typeOf(identification),
            monitoring: await typeOf(await child(id, [index(MACHINE_TOOL), "Monitoring"])),
            production: await typeOf(await child(id, [index(MACHINE_TOOL), "Production"])),
            notification: await typeOf(await child(id, [index(MACHINE_TOOL), "Notification"])),
            itemState: await typeOf(item),
            result: await typeOf(last),
        },
        manufacturer: await value(await child(identification, [index(DI), "Manufacturer"])),
        serialNumber: await value(await child(identification, [index(DI), "SerialNumber"])),
        productInstanceUri: await value(await child(identification, [index(DI), "ProductInstanceUri"])),
        program: await value(await child(state, [0, "CurrentState"])),
        itemState: await value(await child(item, [0, "CurrentState"])),
        packml: await value(await child(
            id, [index(MACHINE_TOOL), "Monitoring"], [own, "Calibration"], [own, "PackMLState"])),
        ve: await value(await child(last, [own, "VE"])),
        vce: await value(await child(last, [own, "VCE"])),
        verdict: await value(await child(last, [own, "Verdict"])),
        ended: await value(await child(meta, [index(RESULT), "CreationTime"])),
        whole: await value(last),
    }));
    await session.close();
    await client.disconnect();
}

main().then(() => process.exit(0), (error) => { console.error(error); process.exit(1); });
