// A host of the plugin made of the OpenFX project's own HostSupport library: it renders a clip of raw images, as a job file says.
//
//     host PLUGIN_IDENTIFIER JOB
//
// A job has one statement a line; words are parted by single spaces, and the last word of `set` is the rest of the line.
//
//     project WIDTH HEIGHT                                      size of the project, px
//     frames FIRST LAST                                         the frames that are rendered, and that the clips have
//     clip NAME DEPTH COMPONENTS X1 Y1 X2 Y2 up|down FOLDER     FOLDER/FRAME.raw has the rows from the lowest one on, without padding;
//                                                               "down": the rows are stored from the top in memory
//     output X1 Y1 X2 Y2 up|down FOLDER                         the render window, and where FRAME.raw is written
//     context filter|general                                    [general]
//     set PARAMETER VALUE
//     press BUTTON                                              as if a person pressed it, before the frames are rendered
//
// What the plugin says goes to standard output as "MESSAGE text", a failure as "STATUS number".

#include <cassert>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "ofxCore.h"
#include "ofxImageEffect.h"
#include "ofxPixels.h"

#include "ofxhBinary.h"
#include "ofxhPropertySuite.h"
#include "ofxhClip.h"
#include "ofxhParam.h"
#include "ofxhMemory.h"
#include "ofxhImageEffect.h"
#include "ofxhPluginAPICache.h"
#include "ofxhPluginCache.h"
#include "ofxhHost.h"
#include "ofxhImageEffectAPI.h"

using namespace OFX::Host;

namespace {

struct ClipJob {
  std::string depth, components, folder;
  OfxRectI bounds;
  bool down;
};

struct Job {
  double width = 0, height = 0;
  int first = 1, last = 1;
  std::map<std::string, ClipJob> clips;
  ClipJob output;
  std::vector<std::pair<std::string, std::string>> values;
  std::vector<std::string> presses;
  std::string context = kOfxImageEffectContextGeneral;
} job;

int bytesOf(const std::string &depth) {
  return depth == kOfxBitDepthByte ? 1 : depth == kOfxBitDepthFloat ? 4 : 2;
}

int channelsOf(const std::string &components) {
  return components == kOfxImageComponentRGBA ? 4 : components == kOfxImageComponentRGB ? 3 : 1;
}

void say(const char *format, va_list args) {
  printf("MESSAGE ");
  vprintf(format, args);
  printf("\n");
}

// An image whose rows are padded, and stored upwards or downwards.
class RawImage : public ImageEffect::Image {
  std::vector<unsigned char> memory;
  OfxRectI bounds;
  size_t used, row;
  bool down;

  unsigned char *at(int y) {
    int rows = bounds.y2 - bounds.y1;
    return memory.data() + row * (down ? rows - 1 - y : y);
  }

public:
  RawImage(ImageEffect::ClipInstance &clip, const OfxRectI &b, bool d)
    : ImageEffect::Image(clip), bounds(b), down(d) {
    used = size_t(b.x2 - b.x1) * channelsOf(clip.getComponents()) * bytesOf(clip.getPixelDepth());
    row = used + 16;
    memory.resize(row * (b.y2 - b.y1));
    setDoubleProperty(kOfxImageEffectPropRenderScale, 1.0, 0);
    setDoubleProperty(kOfxImageEffectPropRenderScale, 1.0, 1);
    int ends[4] = {b.x1, b.y1, b.x2, b.y2};
    for (int i = 0; i < 4; ++i) {
      setIntProperty(kOfxImagePropBounds, ends[i], i);
      setIntProperty(kOfxImagePropRegionOfDefinition, ends[i], i);
    }
    setPointerProperty(kOfxImagePropData, at(0));
    setIntProperty(kOfxImagePropRowBytes, down ? -int(row) : int(row));
    setStringProperty(kOfxImagePropField, kOfxImageFieldNone);
  }

  bool read(const std::string &path) {
    std::ifstream file(path, std::ios::binary);
    for (int y = 0; file && y < bounds.y2 - bounds.y1; ++y)
      file.read(reinterpret_cast<char *>(at(y)), used);
    return bool(file);
  }

  void write(const std::string &path) {
    std::ofstream file(path, std::ios::binary);
    for (int y = 0; y < bounds.y2 - bounds.y1; ++y)
      file.write(reinterpret_cast<const char *>(at(y)), used);
  }
};

class Clip : public ImageEffect::ClipInstance {
  const ClipJob *of;

public:
  RawImage *rendered = nullptr;

  Clip(ImageEffect::Instance *effect, ImageEffect::ClipDescriptor *descriptor)
    : ImageEffect::ClipInstance(effect, *descriptor) {
    auto found = job.clips.find(getName());
    of = isOutput() ? &job.output : found == job.clips.end() ? nullptr : &found->second;
  }
  ~Clip() { forget(); }

  void forget() {
    if (rendered)
      rendered->releaseReference();
    rendered = nullptr;
  }

  const std::string &getUnmappedBitDepth() const override {
    static const std::string none(kOfxBitDepthNone);
    return of ? of->depth : none;
  }
  const std::string &getUnmappedComponents() const override {
    static const std::string none(kOfxImageComponentNone);
    return of ? of->components : none;
  }
  const std::string &getPremult() const override {
    static const std::string v(kOfxImagePreMultiplied);
    return v;
  }
  double getAspectRatio() const override { return 1; }
  double getFrameRate() const override { return 25; }
  void getFrameRange(double &first, double &last) const override {
    first = job.first;
    last = job.last;
  }
  const std::string &getFieldOrder() const override {
    static const std::string v(kOfxImageFieldNone);
    return v;
  }
  bool getConnected() const override { return of; }
  double getUnmappedFrameRate() const override { return 25; }
  void getUnmappedFrameRange(double &first, double &last) const override { getFrameRange(first, last); }
  bool getContinuousSamples() const override { return false; }
  OfxRectD getRegionOfDefinition(OfxTime) const override {
    OfxRectD r = {0, 0, job.width, job.height};
    if (of && !isOutput()) {
      const OfxRectI &b = of->bounds;
      r = {double(b.x1), double(b.y1), double(b.x2), double(b.y2)};
    }
    return r;
  }
  ImageEffect::Image *getImage(OfxTime time, const OfxRectD *) override {
    if (!of)
      return nullptr;
    if (isOutput()) {
      if (!rendered)
        rendered = new RawImage(*this, of->bounds, of->down);
      rendered->addReference();
      return rendered;
    }
    std::unique_ptr<RawImage> image(new RawImage(*this, of->bounds, of->down));
    std::ostringstream path;
    path << of->folder << "/" << int(time) << ".raw";
    return image->read(path.str()) ? image.release() : nullptr;
  }
};

template <class Base, class T> class Held : public Base {
protected:
  T value;

public:
  template <class... A> Held(T v, A &&...a) : Base(a...), value(v) {}
  OfxStatus get(T &v) override {
    v = value;
    return kOfxStatOK;
  }
  OfxStatus get(OfxTime, T &v) override { return get(v); }
  OfxStatus set(T v) override {
    value = v;
    return kOfxStatOK;
  }
  OfxStatus set(OfxTime, T v) override { return set(v); }
};

struct Double : Held<Param::DoubleInstance, double> {
  using Held::Held;
  OfxStatus derive(OfxTime, double &) override { return kOfxStatErrMissingHostFeature; }
  OfxStatus integrate(OfxTime, OfxTime, double &) override { return kOfxStatErrMissingHostFeature; }
};

struct String : Param::StringInstance {
  std::string value;
  String(const std::string &v, Param::Descriptor &d, Param::SetInstance *s) : StringInstance(d, s), value(v) {}
  OfxStatus get(std::string &v) override {
    v = value;
    return kOfxStatOK;
  }
  OfxStatus get(OfxTime, std::string &v) override { return get(v); }
  OfxStatus set(const char *v) override {
    value = v;
    return kOfxStatOK;
  }
  OfxStatus set(OfxTime, const char *v) override { return set(v); }
};

class Effect : public ImageEffect::Instance {
public:
  std::map<std::string, String *> texts;
  double progress = 0;

  Effect(ImageEffect::ImageEffectPlugin *plugin, ImageEffect::Descriptor &desc, const std::string &context)
    : ImageEffect::Instance(plugin, desc, context, false) {}

  const std::string &getDefaultOutputFielding() const override {
    static const std::string v(kOfxImageFieldNone);
    return v;
  }
  ImageEffect::ClipInstance *newClipInstance(ImageEffect::Instance *, ImageEffect::ClipDescriptor *d, int) override {
    return new Clip(this, d);
  }
  OfxStatus vmessage(const char *, const char *, const char *format, va_list args) override {
    say(format, args);
    return kOfxStatOK;
  }
  OfxStatus setPersistentMessage(const char *, const char *, const char *format, va_list args) override {
    say(format, args);
    return kOfxStatOK;
  }
  OfxStatus clearPersistentMessage() override { return kOfxStatOK; }
  void getProjectSize(double &x, double &y) const override {
    x = job.width;
    y = job.height;
  }
  void getProjectOffset(double &x, double &y) const override { x = y = 0; }
  void getProjectExtent(double &x, double &y) const override { getProjectSize(x, y); }
  double getProjectPixelAspectRatio() const override { return 1; }
  double getEffectDuration() const override { return job.last - job.first + 1; }
  double getFrameRate() const override { return 25; }
  double getFrameRecursive() const override { return job.first; }
  void getRenderScaleRecursive(double &x, double &y) const override { x = y = 1; }

  Param::Instance *newParam(const std::string &name, Param::Descriptor &d) override {
    std::string given;
    bool isGiven = false;
    for (auto &value : job.values)
      if (value.first == name) {
        given = value.second;
        isGiven = true;
      }
    const Property::Set &p = d.getProperties();
    const std::string &type = d.getType();
    if (type == kOfxParamTypeInteger)
      return new Held<Param::IntegerInstance, int>(
        isGiven ? std::stoi(given) : p.getIntProperty(kOfxParamPropDefault), d, this);
    if (type == kOfxParamTypeDouble)
      return new Double(isGiven ? std::stod(given) : p.getDoubleProperty(kOfxParamPropDefault), d, this);
    if (type == kOfxParamTypeBoolean)
      return new Held<Param::BooleanInstance, bool>(
        isGiven ? std::stoi(given) != 0 : p.getIntProperty(kOfxParamPropDefault) != 0, d, this);
    if (type == kOfxParamTypeChoice)
      return new Held<Param::ChoiceInstance, int>(
        isGiven ? std::stoi(given) : p.getIntProperty(kOfxParamPropDefault), d, this);
    if (type == kOfxParamTypeString)
      return texts[name] = new String(isGiven ? given : p.getStringProperty(kOfxParamPropDefault), d, this);
    if (type == kOfxParamTypePushButton)
      return new Param::PushbuttonInstance(d, this);
    return nullptr;
  }
  OfxStatus editBegin(const std::string &) override { return kOfxStatOK; }
  OfxStatus editEnd() override { return kOfxStatOK; }
  void progressStart(const std::string &, const std::string &) override { progress = 0; }
  void progressEnd() override { printf("PROGRESS %g\n", progress); }
  bool progressUpdate(double t) override {
    progress = t;
    return true;
  }
  double timeLineGetTime() override { return job.first; }
  void timeLineGotoTime(double) override {}
  void timeLineGetBounds(double &first, double &last) override {
    first = job.first;
    last = job.last;
  }
};

class TestHost : public ImageEffect::Host {
public:
  TestHost() {
    _properties.setIntProperty(kOfxPropAPIVersion, 1, 0);
    _properties.setIntProperty(kOfxPropAPIVersion, 4, 1);
    _properties.setStringProperty(kOfxPropName, "blindaug's test");
    _properties.setIntProperty(kOfxImageEffectPropSupportsMultiResolution, 1);
    _properties.setIntProperty(kOfxImageEffectPropSupportsTiles, 1);
    _properties.setIntProperty(kOfxImageEffectPropTemporalClipAccess, 1);
    _properties.setStringProperty(kOfxImageEffectPropSupportedComponents, kOfxImageComponentRGBA, 0);
    _properties.setStringProperty(kOfxImageEffectPropSupportedComponents, kOfxImageComponentRGB, 1);
    _properties.setStringProperty(kOfxImageEffectPropSupportedComponents, kOfxImageComponentAlpha, 2);
    _properties.setStringProperty(kOfxImageEffectPropSupportedContexts, kOfxImageEffectContextFilter, 0);
    _properties.setStringProperty(kOfxImageEffectPropSupportedContexts, kOfxImageEffectContextGeneral, 1);
    _properties.setStringProperty(kOfxImageEffectPropSupportedPixelDepths, kOfxBitDepthByte, 0);
    _properties.setStringProperty(kOfxImageEffectPropSupportedPixelDepths, kOfxBitDepthShort, 1);
    _properties.setStringProperty(kOfxImageEffectPropSupportedPixelDepths, kOfxBitDepthHalf, 2);
    _properties.setStringProperty(kOfxImageEffectPropSupportedPixelDepths, kOfxBitDepthFloat, 3);
    _properties.setIntProperty(kOfxImageEffectPropSupportsMultipleClipDepths, 1);
  }
  ImageEffect::Instance *newInstance(void *, ImageEffect::ImageEffectPlugin *plugin, ImageEffect::Descriptor &desc,
                                     const std::string &context) override {
    return new Effect(plugin, desc, context);
  }
  ImageEffect::Descriptor *makeDescriptor(ImageEffect::ImageEffectPlugin *plugin) override {
    return new ImageEffect::Descriptor(plugin);
  }
  ImageEffect::Descriptor *makeDescriptor(const ImageEffect::Descriptor &root, ImageEffect::ImageEffectPlugin *plugin) override {
    return new ImageEffect::Descriptor(root, plugin);
  }
  ImageEffect::Descriptor *makeDescriptor(const std::string &bundle, ImageEffect::ImageEffectPlugin *plugin) override {
    return new ImageEffect::Descriptor(bundle, plugin);
  }
  OfxStatus vmessage(const char *, const char *, const char *format, va_list args) override {
    say(format, args);
    return kOfxStatOK;
  }
  OfxStatus setPersistentMessage(const char *, const char *, const char *format, va_list args) override {
    say(format, args);
    return kOfxStatOK;
  }
  OfxStatus clearPersistentMessage() override { return kOfxStatOK; }
};

bool readJob(const char *path) {
  std::ifstream file(path);
  std::string line;
  while (std::getline(file, line)) {
    std::istringstream words(line);
    std::string what, name, way;
    words >> what;
    if (what == "project")
      words >> job.width >> job.height;
    else if (what == "frames")
      words >> job.first >> job.last;
    else if (what == "clip" || what == "output") {
      ClipJob clip;
      if (what == "clip")
        words >> name >> clip.depth >> clip.components;
      OfxRectI &b = clip.bounds;
      words >> b.x1 >> b.y1 >> b.x2 >> b.y2 >> way >> std::ws;
      std::getline(words, clip.folder);
      clip.down = way == "down";
      if (what == "clip")
        job.clips[name] = clip;
      else
        job.output = clip;
    } else if (what == "context") {
      words >> name;
      if (name == "filter")
        job.context = kOfxImageEffectContextFilter;
    } else if (what == "set") {
      std::string value;
      words >> name >> std::ws;
      std::getline(words, value);
      job.values.emplace_back(name, value);
    } else if (what == "press") {
      words >> name;
      job.presses.push_back(name);
    }
  }
  // The output has the source's kind of values and channels.
  job.output.depth = job.clips["Source"].depth;
  job.output.components = kOfxImageComponentRGBA;
  return job.width > 0;
}

int failed(const char *what, OfxStatus status) {
  printf("%s\nSTATUS %d\n", what, status);
  return 1;
}

bool ok(OfxStatus status) { return status == kOfxStatOK || status == kOfxStatReplyDefault; }

} // namespace

int main(int count, char **words) {
  if (count != 3 || !readJob(words[2])) {
    fprintf(stderr, "usage: OFX_PLUGIN_PATH=FOLDER host PLUGIN_IDENTIFIER JOB\n");
    return 2;
  }
  PluginCache::getPluginCache()->setCacheVersion("blindaug-1");
  TestHost host;
  ImageEffect::PluginCache plugins(host);
  plugins.registerInCache(*PluginCache::getPluginCache());
  PluginCache::getPluginCache()->scanPluginFiles();
  ImageEffect::ImageEffectPlugin *plugin = plugins.getPluginById(words[1]);
  if (!plugin)
    return failed("the plugin is not in OFX_PLUGIN_PATH", kOfxStatFailed);
  {
    std::unique_ptr<ImageEffect::Instance> made(plugin->createInstance(job.context, nullptr));
    Effect *effect = dynamic_cast<Effect *>(made.get());
    if (!effect)
      return failed("no instance", kOfxStatFailed);
    OfxStatus status = effect->createInstanceAction();
    if (!ok(status))
      return failed("createInstance", status);
    if (!effect->getClipPreferences())
      return failed("getClipPreferences", kOfxStatFailed);
    Clip *output = dynamic_cast<Clip *>(effect->getClip(kOfxImageEffectOutputClipName));
    OfxPointD scale = {1, 1};
    for (auto &button : job.presses) {
      effect->beginInstanceChangedAction(kOfxChangeUserEdited);
      status = effect->paramInstanceChangedAction(button, kOfxChangeUserEdited, job.first, scale);
      effect->endInstanceChangedAction(kOfxChangeUserEdited);
      if (!ok(status))
        return failed("instanceChanged", status);
      for (auto &text : effect->texts) {
        std::ofstream file(job.output.folder + "/" + text.first + ".txt", std::ios::binary);
        file << text.second->value;
      }
    }
    printf("OUTPUT %s %s varying %d\n", output->getPixelDepth().c_str(), output->getComponents().c_str(),
           effect->isFrameVarying());
    OfxRectI window = job.output.bounds;
    OfxRectD region = {double(window.x1), double(window.y1), double(window.x2), double(window.y2)};
    status = effect->beginRenderAction(job.first, job.last, 1.0, false, scale, true, false);
    if (!ok(status))
      return failed("beginRender", status);
    for (int t = job.first; t <= job.last; ++t) {
      OfxRectD defined;
      status = effect->getRegionOfDefinitionAction(t, scale, defined);
      if (!ok(status))
        return failed("getRegionOfDefinition", status);
      std::map<ImageEffect::ClipInstance *, OfxRectD> interest;
      status = effect->getRegionOfInterestAction(t, scale, region, interest);
      if (!ok(status))
        return failed("getRegionsOfInterest", status);
      for (auto &of : interest)
        if (of.first->getConnected() && !of.first->isOutput() &&
            (of.second.x1 > 0 || of.second.y1 > 0 || of.second.x2 < job.width || of.second.y2 < job.height))
          return failed("not all of an input is asked for", kOfxStatFailed);
      ImageEffect::RangeMap needed;
      status = effect->getFrameNeededAction(t, needed);
      if (!ok(status))
        return failed("getFramesNeeded", status);
      output->forget();
      status = effect->renderAction(t, kOfxImageFieldNone, window, scale, true, false, false);
      if (status != kOfxStatOK)
        return failed("render", status);
      std::ostringstream path;
      path << job.output.folder << "/" << t << ".raw";
      if (output->rendered)
        output->rendered->write(path.str());
    }
    effect->endRenderAction(job.first, job.last, 1.0, false, scale, true, false);
  }
  PluginCache::clearPluginCache();
  return 0;
}
