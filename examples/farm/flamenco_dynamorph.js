// SPDX-License-Identifier: GPL-3.0-or-later
// Flamenco job type: bakes the open file's soft skins, one task per character and wedge. It goes into the folder
// `scripts` beside flamenco-manager; docs/farm.md says more. A task is one whole simulation, never a part of its frames.

const JOB_TYPE = {
    label: "Dynamorph Bake",
    description: "Simulate soft skins and write them as shape keys",
    settings: [
        {
            key: "characters", type: "string", default: "",
            eval: "', '.join(o.name for o in C.scene.objects if o.type == 'MESH' and len(o.dynamorph.targets))",
            evalInfo: { showLinkButton: true, description: "Soft skins of the scene" },
            description: "Names of the objects, separated by commas. If empty, one task bakes all soft skins",
        },
        {
            key: "wedges", type: "string", default: "",
            description: "TARGET.PROPERTY=VALUE, separated by commas. Each gets a bake. If empty, the file is baked as it is",
        },
        {
            key: "format", type: "string", default: "",
            description: "modes, pc2, gltf, fbx, alembic, usd or soft_skin. If empty, each object uses its own setting",
        },
        {
            key: "options", type: "string", default: "",
            description: "More options of bake, separated by spaces, for example --keys 8",
        },
        {
            key: "output", type: "string", subtype: "dir_path", required: true,
            description: "Existing folder for the baked files and for a folder of reports per job",
        },
        {
            key: "cache_dir", type: "string", subtype: "dir_path", required: true,
            description: "Folder for models and checkpoints, the same for all shots of a character",
        },
        { key: "blendfile", type: "string", required: true, visible: "web", description: "The .blend file to bake" },
    ],
};

const ENDINGS = { gltf: "glb", fbx: "fbx", alembic: "abc", usd: "usdc", soft_skin: "dynamorph", pc2: "pc2" };

function compileJob(job) {
    const settings = job.settings;
    const shot = settings.blendfile.split(/[\\/]/).pop().replace(/(\.flamenco)?\.blend$/, "");
    const characters = namesOrNone(settings.characters), wedges = namesOrNone(settings.wedges);
    const reports = `${settings.output}/${shot} ${formatTimestampLocal(job.created)}`;  // contains no reports of other jobs
    const expected = String(characters.length * wedges.length);
    const collect = authorTask(
        "collect", ["collect", reports, "-o", `${reports}/index.html`, "--expect", expected]);
    for (const character of characters) {
        const who = character ? ["--object", character] : ["--all"];
        const check = authorTask(`check ${character || "all"}`, ["check", ...who], settings.blendfile);
        const build = authorTask(
            `build ${character || "all"}`, ["build", ...who, "--cache-dir", settings.cache_dir], settings.blendfile);
        build.addDependency(check);
        job.addTask(check);
        job.addTask(build);
        for (const wedge of wedges) {
            const bake = authorBake(settings, shot, character, wedge, reports);
            bake.addDependency(build);
            collect.addDependency(bake);
            job.addTask(bake);
        }
    }
    job.addTask(collect);
}

function authorBake(settings, shot, character, wedge, reports) {
    const name = joined(shot, character, wedge);
    return authorTask(`bake ${name}`, [
        "bake", ...(character ? ["--object", character] : ["--all"]), ...(wedge ? ["--set", wedge] : []),
        ...formatOf(settings, shot, wedge), ...settings.options.split(/\s+/).filter(Boolean), "--cache-dir", settings.cache_dir,
        "-o", `${settings.output}/${name}.blend`, "--report", `${reports}/${name}.json`,
    ], settings.blendfile);
}

// A file is beside the baked .blend. Dynamorph replaces {object} with a mesh's name: each piece of clothing has its own point cache.
function formatOf(settings, shot, wedge) {
    if (!settings.format) return [];
    const ending = ENDINGS[settings.format];
    const file = ending ? ["--output-file", `${settings.output}/${joined(shot, "{object}", wedge)}.${ending}`] : [];
    return ["--format", settings.format, ...file];
}

// With "exec" and not "blender-render": nothing is rendered, and everything after -c belongs to Dynamorph.
function authorTask(name, command, ...blendfile) {
    const task = author.Task(name, "blender");
    const args = ["-b", ...blendfile, "-c", "dynamorph", ...command];
    task.addCommand(author.Command("exec", { exe: "{blender}", args: args }));
    return task;
}

function joined(...names) {
    return names.filter(Boolean).join(" ").replace(/[\\/]/g, "_");  // a part of the name of a file
}

// [""] without names: one task for all characters, or one bake of the file as it is.
function namesOrNone(list) {
    const names = list.split(",").map((name) => name.trim()).filter(Boolean);
    return names.length ? names : [""];
}
