// Speech from files and from the microphone, as the 16 kHz mono that the models hear.

const SPEECH_HZ = 16000;
const TAP = `registerProcessor("tap", class extends AudioWorkletProcessor {
  process([input]) { if (input[0]) this.port.postMessage(input[0].slice()); return true; }
});`;

/** Calls `take` with blocks of what a node plays. */
async function tap(context, node, take) {
  const address = URL.createObjectURL(new Blob([TAP], { type: "text/javascript" }));
  try {
    await context.audioWorklet.addModule(address);
  } finally {
    URL.revokeObjectURL(address);
  }
  const worklet = new AudioWorkletNode(context, "tap", { numberOfOutputs: 0, channelCount: 1, channelCountMode: "explicit" });
  worklet.port.onmessage = ({ data }) => take(data);
  node.connect(worklet);
  return worklet;
}

const toInt16 = (samples) => Int16Array.from(samples, (value) => Math.round(clamp(value, -1, 1) * 32767));

/** A WAV file of mono samples. */
function wavOf(samples) {
  const header = new DataView(new ArrayBuffer(44));
  const text = (at, word) => [...word].forEach((sign, i) => header.setUint8(at + i, sign.charCodeAt(0)));
  text(0, "RIFF"); header.setUint32(4, 36 + 2 * samples.length, true); text(8, "WAVEfmt ");
  header.setUint32(16, 16, true); header.setUint16(20, 1, true); header.setUint16(22, 1, true);
  header.setUint32(24, SPEECH_HZ, true); header.setUint32(28, 2 * SPEECH_HZ, true);
  header.setUint16(32, 2, true); header.setUint16(34, 16, true);
  text(36, "data"); header.setUint32(40, 2 * samples.length, true);
  return new Blob([header, toInt16(samples)], { type: "audio/wav" });
}

/** Whatever the browser can play, as a WAV. */
async function fileToWav(file) {
  let sound;
  try {
    sound = await new OfflineAudioContext(1, 1, SPEECH_HZ).decodeAudioData(await file.arrayBuffer());
  } catch {
    throw new Error(`“${file.name}” holds no sound that this browser can read.`);
  }
  const mean = new Float32Array(sound.length);
  for (let c = 0; c < sound.numberOfChannels; ++c) sound.getChannelData(c).forEach((value, i) => (mean[i] += value / sound.numberOfChannels));
  return wavOf(mean);
}

async function openMicrophone() {
  if (!navigator.mediaDevices?.getUserMedia) throw new Error("Browsers give a microphone to https addresses and to this machine alone.");
  try {
    return await navigator.mediaDevices.getUserMedia({ audio: { channelCount: 1, echoCancellation: false, noiseSuppression: false, autoGainControl: true } });
  } catch (error) {
    throw new Error(error.name === "NotFoundError" ? "There is no microphone." : "The browser did not give the microphone: allow it beside the address.");
  }
}

/** Records until it is stopped. */
class VoiceRecorder {
  async start(longest, onend) {
    this.stream = await openMicrophone();
    this.context = new AudioContext({ sampleRate: SPEECH_HZ });
    this.blocks = [];
    this.count = 0;
    await tap(this.context, this.context.createMediaStreamSource(this.stream), (block) => {
      this.blocks.push(block);
      this.count += block.length;
      if (this.count >= longest * SPEECH_HZ) onend();
    });
  }

  get seconds() { return this.count / SPEECH_HZ; }

  stop() {
    for (const track of this.stream.getTracks()) track.stop();
    this.context.close();
    const samples = new Float32Array(this.count);
    let at = 0;
    for (const block of this.blocks) { samples.set(block, at); at += block.length; }
    return wavOf(samples);
  }
}
