// SPDX-License-Identifier: GPL-3.0-or-later
// Flamenco job type: bakes the open file's soft skins, a task for each character and wedge. It goes into the folder
// `scripts` beside flamenco-manager; docs/farm.md says more. A task is one whole simulation, never a part of its frames.

const JOB_TYPE = {
    label: "Dynamorph Bake",
    description: "Simulate soft skins and write them as shape keys",
    settings: [
        {
            key: "characters", type: "string", required: true,
            eval: "', '.join(o.name for o in C.scene.objects if o.type == 'MESH' and len(o.dynamorph.targets))",
            evalInfo: { showLinkButton: true, description: "Soft skins of the scene" },
            description: "Names of the objects, with commas between them",
        },
        {
            key: "wedges", type: "string", default: "",
            description: "TARGET.PROPERTY=VALUE, with commas between them: a bake for each. Empty: one as it is",
        },
        {
            key: "output", type: "string", subtype: "dir_path", required: true,
            description: "Folder for the baked files and reports. It must be there",
        },
        {
            key: "share", type: "string", subtype: "dir_path", required: true,
            description: "Folder for models and checkpoints, the same for all shots of a character",
        },
        { key: "blendfile", type: "string", required: true, visible: "web", description: "The .blend to bake" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const collect = authorTask("collect", ["collect", settings.output, "-o", `${settings.output}/index.html`]);
    for (const character of namesIn(settings.characters)) {
        const check = authorTask(`check ${character}`, ["check", "--object", character], settings.blendfile);
        const build = authorTask(
            `build ${character}`, ["build", "--object", character, "--share", settings.share], settings.blendfile);
        build.addDependency(check);
        job.addTask(check);
        job.addTask(build);
        for (const wedge of wedgesIn(settings.wedges)) {
            const bake = authorBake(settings, character, wedge);
            bake.addDependency(build);
            collect.addDependency(bake);
            job.addTask(bake);
        }
    }
    job.addTask(collect);
}

function authorBake(settings, character, wedge) {
    const shot = settings.blendfile.split(/[\\/]/).pop().replace(/(\.flamenco)?\.blend$/, "");
    const name = [shot, character, wedge].filter(Boolean).join(" ");
    const set = wedge ? ["--set", wedge] : [];
    return authorTask(`bake ${name}`, [
        "bake", "--object", character, ...set, "--share", settings.share,
        "-o", `${settings.output}/${name}.blend`, "--report", `${settings.output}/${name}.json`,
    ], settings.blendfile);
}

// With "exec" and not "blender-render": nothing is rendered, and all that is after -c belongs to Dynamorph.
function authorTask(name, command, ...blendfile) {
    const task = author.Task(name, "blender");
    const args = ["-b", ...blendfile, "-c", "dynamorph", ...command];
    task.addCommand(author.Command("exec", { exe: "{blender}", args: args }));
    return task;
}

function namesIn(list) {
    return list.split(",").map((name) => name.trim()).filter(Boolean);
}

function wedgesIn(list) {
    const wedges = namesIn(list);
    return wedges.length ? wedges : [""];  // one bake as it is
}
