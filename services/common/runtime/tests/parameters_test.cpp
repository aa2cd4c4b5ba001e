// Every error names its place, key, value and the allowed values; valid values are set.

#include "common/runtime/parameters.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "common/runtime/config.hpp"

namespace zloam::runtime {
namespace {

using testing::HasSubstr;

enum class Mode { kSoft, kHard };

struct Config {
  double range_m = 5.0;
  float noise_m = 0.02F;
  int count = 3;
  std::uint64_t big = 7;
  bool on = false;
  std::string name = "x";
  std::string choice = "a";
  Mode mode = Mode::kSoft;
  Eigen::Vector3d xyz = Eigen::Vector3d::Zero();
  std::array<int, 3> tiles = {1, 2, 3};
  std::vector<std::string> list;
};

struct ParameterFile : testing::Test {
  Config c;
  Parameters p;
  ParameterFile() {
    p.add("stage.range_m", &c.range_m, {0.0, 100.0}, "m", "how far");
    p.add("stage.noise_m", &c.noise_m, {0.0, 1.0}, "m", "noise");
    p.add("stage.deep.count", &c.count, {1, 10}, "", "how many");
    p.add("stage.big", &c.big, {}, "", "large");
    p.add("stage.on", &c.on, "switch");
    p.add("stage.name", &c.name, "name", Effect::kNone);
    p.add("stage.choice", &c.choice, {"a", "b"}, "one of two");
    p.add("stage.mode", &c.mode, {{"soft", Mode::kSoft}, {"hard", Mode::kHard}}, "mode");
    p.add("stage.xyz", &c.xyz, {-1.0, 1.0}, "m", "place");
    p.add("stage.tiles", &c.tiles, {1, 99}, "", "tiles");
    p.add("stage.list", &c.list, "texts");
    p.check("stage.big", [this] { return c.big == 13 ? "must not be 13" : ""; });
    p.check("stage.noise_m",
            [this] { return c.range_m < 1.0 && c.noise_m > 0.3F ? "is too much" : ""; },
            {"stage.deep.count", "stage.range_m"});
  }
  std::string error(const std::string& text, const std::vector<std::string>& settings = {}) {
    try {
      p.load_text(text, "robot.yaml", settings, {"other"});
    } catch (const ConfigError& e) {
      return e.what();
    }
    return {};
  }
};

TEST_F(ParameterFile, SetsEveryType) {
  EXPECT_EQ(
      error("stage:\n"
            "  range_m: 7.5\n  noise_m: 0.03\n  deep:\n    count: 4\n  big: 9007199254740991\n"
            "  on: true\n  name: ü b\n  choice: b\n  mode: hard\n  xyz: [0.1, -0.2, 1]\n"
            "  tiles: [4, 5, 6]\n  list: [p, q]\n"),
      "");
  EXPECT_EQ(c.range_m, 7.5);
  EXPECT_EQ(c.noise_m, 0.03F);
  EXPECT_EQ(c.count, 4);
  EXPECT_EQ(c.big, 9007199254740991U);
  EXPECT_TRUE(c.on);
  EXPECT_EQ(c.name, "ü b");
  EXPECT_EQ(c.choice, "b");
  EXPECT_EQ(c.mode, Mode::kHard);
  EXPECT_EQ(c.xyz, Eigen::Vector3d(0.1, -0.2, 1.0));
  EXPECT_EQ(c.tiles, (std::array<int, 3>{4, 5, 6}));
  EXPECT_EQ(c.list, (std::vector<std::string>{"p", "q"}));
}

TEST_F(ParameterFile, DefaultsHoldWithoutAFile) {
  EXPECT_EQ(error(""), "");
  EXPECT_EQ(c.range_m, 5.0);
  EXPECT_EQ(error("stage:\n"), "");
  EXPECT_EQ(error("other:\n  anything: [1, {a: b}]\n"), "");
}

TEST_F(ParameterFile, UnknownKeyNamesLineAndTheNearestName) {
  const std::string e = error("stage:\n  on: true\n  rnage_m: 3\n");
  EXPECT_EQ(e, "robot.yaml:3: stage.rnage_m: unknown key (did you mean 'stage.range_m'?)");
  EXPECT_THAT(error("stagee:\n  on: true\n"), HasSubstr("robot.yaml:1: stagee: unknown key"));
  EXPECT_EQ(error("stage:\n  zzzzzzzzzzzzzzzzzz: 1\n"),
            "robot.yaml:2: stage.zzzzzzzzzzzzzzzzzz: unknown key");
}

TEST_F(ParameterFile, OutOfRangeNamesValueAndWhatIsAllowed) {
  EXPECT_EQ(
      error("stage:\n  range_m: 100.5\n"),
      "robot.yaml:2: stage.range_m: value '100.5' is refused: out of range; allowed: 0 to 100 "
      "m");
  EXPECT_THAT(error("stage:\n  deep:\n    count: 0\n"),
              HasSubstr("robot.yaml:3: stage.deep.count: value '0' is refused: out of range; "
                        "allowed: 1 to 10"));
  EXPECT_THAT(error("stage:\n  big: -1\n"), HasSubstr("out of range"));
  EXPECT_THAT(error("stage:\n  xyz: [0, 0, 2]\n"), HasSubstr("value [0, 0, 2] is refused"));
  EXPECT_EQ(c.range_m, 5.0);
  EXPECT_EQ(c.xyz, Eigen::Vector3d::Zero());
}

TEST_F(ParameterFile, WrongTypesAreRefused) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"range_m: fast", "a number is expected"},
      {"range_m: nan", "a number is expected"},
      {"range_m: .inf", "a number is expected"},
      {"range_m: 1e999", "a number is expected"},
      {"range_m: 5m", "a number is expected"},
      {"range_m: [1]", "a single value is expected"},
      {"range_m: {a: 1}", "a single value is expected"},
      {"range_m:", "a single value is expected"},
      {"deep: {count: 2.5}", "a whole number is expected"},
      {"deep: {count: 99999999999999999999}", "a whole number is expected"},
      {"deep: 4", "a section with keys of its own is expected"},
      {"on: yes", "true or false is expected"},
      {"on: 1", "true or false is expected"},
      {"choice: c", "one of a, b"},
      {"mode: Soft", "one of soft, hard"},
      {"xyz: [1, 2]", "a list of 3 numbers is expected"},
      {"xyz: 1", "a list of 3 numbers is expected"},
      {"tiles: [1, 2, 2.5]", "a whole number is expected"},
      {"list: text", "a list is expected"},
      {"name: [a]", "a single value is expected"},
  };
  for (const auto& [line, expected] : cases) {
    const std::string e = error("stage:\n  " + line + "\n");
    EXPECT_THAT(e, HasSubstr("robot.yaml:2: stage.")) << line;
    EXPECT_THAT(e, HasSubstr(expected)) << line;
  }
}

TEST_F(ParameterFile, AllErrorsAreNamedAtOnce) {
  const std::string e = error("stage:\n  range_m: -1\n  on: 3\n", {"stage.mode=none"});
  EXPECT_THAT(e, HasSubstr("robot.yaml:2: stage.range_m"));
  EXPECT_THAT(e, HasSubstr("robot.yaml:3: stage.on"));
  EXPECT_THAT(e, HasSubstr("--set stage.mode: stage.mode: value 'none'"));
}

TEST_F(ParameterFile, SettingsOverrideTheFileAndAreCheckedAlike) {
  EXPECT_EQ(error("stage:\n  range_m: 7\n",
                  {"stage.range_m=8", "stage.xyz=[0, 0, 1]", "stage.name=a=b", "other.key=1"}),
            "");
  EXPECT_EQ(c.range_m, 8.0);
  EXPECT_EQ(c.xyz.z(), 1.0);
  EXPECT_EQ(c.name, "a=b");
  EXPECT_EQ(error("", {"stage.rnage_m=1"}),
            "--set stage.rnage_m: stage.rnage_m: unknown key (did you mean 'stage.range_m'?)");
  EXPECT_THAT(error("", {"stage.range_m"}), HasSubstr("key=value is expected"));
  EXPECT_THAT(error("", {"stage.range_m=101"}), HasSubstr("0 to 100 m"));
}

TEST_F(ParameterFile, ATextOnTheCommandLineIsTakenAsItStands) {
  for (const char* text :
       {"/data/day #2: hall.pcap", "[a", "{b}", "\"q\"", "'", "01", "~", "null", "- x", "*x", "&x",
        "!x", "a: b", "%", " two  blanks ", "", "line\nbreak", "\xC3\xBC"}) {
    EXPECT_EQ(error("", {std::string("stage.name=") + text}), "");
    EXPECT_EQ(c.name, text);
  }
}

TEST_F(ParameterFile, AHomeFolderThatNothingExpandsIsRefused) {
  EXPECT_EQ(error("stage:\n  name: ~/maps\n"),
            "robot.yaml:2: stage.name: value '~/maps' is refused: '~' is not expanded: write the "
            "whole path; allowed: any text");
  EXPECT_THAT(error("", {"stage.name=~/maps"}), HasSubstr("'~' is not expanded"));
  EXPECT_THAT(error("", {"stage.name=~robot/maps"}), HasSubstr("'~' is not expanded"));
  EXPECT_EQ(error("stage:\n  name: maps/~old\n"), "");
}

TEST_F(ParameterFile, ConditionsOverFieldsNameTheirKeyAndPlace) {
  EXPECT_EQ(error("stage:\n  big: 13\n"), "robot.yaml:2: stage.big: must not be 13");
  EXPECT_EQ(error("stage:\n  big: 1\n", {"stage.big=13"}),
            "--set stage.big: stage.big: must not be 13");
}

TEST_F(ParameterFile, AConditionNamesThePlaceOfTheOtherFieldIfItsOwnIsNotSet) {
  c.noise_m = 0.5F;
  EXPECT_EQ(error("stage:\n  on: true\n  range_m: 0.5\n"),
            "robot.yaml:3: stage.noise_m: is too much");
  EXPECT_EQ(error("stage:\n  range_m: 0.5\n  noise_m: 0.4\n"),
            "robot.yaml:3: stage.noise_m: is too much");
  EXPECT_EQ(error("", {"stage.range_m=0.5"}), "--set stage.range_m: stage.noise_m: is too much");
  EXPECT_EQ(error(""), "robot.yaml: stage.noise_m: is too much");
}

TEST_F(ParameterFile, BrokenYamlAndDoubleKeysNameTheLine) {
  EXPECT_THAT(error("stage:\n  on: [true\n"), HasSubstr("robot.yaml:"));
  EXPECT_THAT(error("stage:\n  on: true\n  on: false\n"),
              HasSubstr("robot.yaml:3: stage.on: stands here a second time"));
  EXPECT_THAT(error("- a\n"), HasSubstr("a map of sections is expected"));
}

TEST_F(ParameterFile, ASecondDocumentIsRefused) {
  for (const char* text : {"stage:\n  on: true\n---\nstage:\n  range_m: 9\n",
                           "stage:\n  on: true\n...\nstage:\n  range_m: 9\n",
                           "# robot\n---\n---\nstage:\n  on: true\n"}) {
    const std::string e = error(text);
    EXPECT_THAT(e, HasSubstr("robot.yaml:4: a second document")) << text;
  }
  EXPECT_EQ(error("%YAML 1.2\n---\nstage:\n  on: true\n...\n"), "");
}

TEST_F(ParameterFile, ACommaTooManyIsRefused) {
  for (const char* text : {"{stage: {on: true}},", "[],", "{},\n", "{stage: {on: true}}\n, {}"}) {
    EXPECT_THAT(error(text), HasSubstr(": a second document")) << text;
  }
  for (const char* text : {"]", "}", "]]", "stage: [1]]", "{}\n---\n]"}) {
    EXPECT_THAT(error(text), HasSubstr("not YAML")) << text;
  }
}

TEST_F(ParameterFile, KeysThatAreNoNamesAreShown) {
  EXPECT_EQ(error("stage:\n  ? [on, big.x]\n  : true\n"),
            "robot.yaml:2: stage.[on, big.x]: a name is expected as key");
  EXPECT_EQ(error("{[stage]: 1, [other]: 1}\n"),
            "robot.yaml:1: [stage]: a name is expected as key\n"
            "robot.yaml:1: [other]: a name is expected as key");
}

TEST_F(ParameterFile, KeysWithDotsAreNoSections) {
  EXPECT_EQ(error("stage.on: true\n"),
            "robot.yaml:1: stage.on: a file has sections, not keys with dots: write stage: {on: "
            "...}");
  EXPECT_FALSE(c.on);
  EXPECT_THAT(error("stage:\n  on: false\nstage.on: true\n"),
              HasSubstr("robot.yaml:3: stage.on: "));
  EXPECT_THAT(error("stage:\n  deep.count: 4\n"),
              HasSubstr("stage.deep.count: a file has sections, not keys with dots: write deep: "));
  EXPECT_THAT(error("other.key: 1\n"), HasSubstr("robot.yaml:1: other.key: a file has sections"));
}

TEST_F(ParameterFile, FileThatIsNotThereIsAnIoError) {
  EXPECT_THROW(p.load("/nowhere/robot.yaml", {}), IoError);
  EXPECT_THROW(p.load(std::filesystem::temp_directory_path().string(), {}), IoError);
}

struct LiveParameters : ParameterFile {
  LiveParameters() {
    p.add("live.m", &m, {0.0, 10.0}, "m", "far").live();
    p.add("live.noise", &noise, {0.0, 1.0}, "m", "noise").live();
    p.add("live.mode", &mode, {{"soft", Mode::kSoft}, {"hard", Mode::kHard}}, "mode").live();
    p.add("live.xyz", &xyz, {-1.0, 1.0}, "m", "place").live();
    p.check("live.m", [this] { return m > 9.0 && noise > 0.5F ? "too noisy for so far" : ""; });
  }
  std::string refusal(const std::vector<std::string>& settings) {
    try {
      p.check_live(settings, "set");
    } catch (const ConfigError& e) {
      return e.what();
    }
    return {};
  }
  double m = 0.1;
  float noise = 0.02F;
  Mode mode = Mode::kSoft;
  Eigen::Vector3d xyz{0.1, -0.2, 1.0 / 3.0};
};

TEST_F(LiveParameters, AreCheckedWithoutBeingChanged) {
  const std::string before = p.live_values_json();
  EXPECT_EQ(p.check_live({"live.m=2", "live.mode=hard"}, "set"),
            R"({"live.m":2.0,"live.mode":"hard"})");
  EXPECT_EQ(p.live_values_json(), before);
  EXPECT_EQ(m, 0.1);
  EXPECT_EQ(noise, 0.02F);
  EXPECT_EQ(xyz.z(), 1.0 / 3.0);
}

TEST_F(LiveParameters, TakeTheValuesOfARevision) {
  p.set_live(R"({"live.m":2.5,"live.noise":0.03,"live.mode":"hard","live.xyz":[0.5,0,-1]})");
  EXPECT_EQ(m, 2.5);
  EXPECT_EQ(noise, 0.03F);
  EXPECT_EQ(mode, Mode::kHard);
  EXPECT_EQ(xyz, Eigen::Vector3d(0.5, 0.0, -1.0));
  EXPECT_THROW(p.set_live(R"({"live.m":11})"), ConfigError);
  EXPECT_THROW(p.set_live(R"({"stage.range_m":1})"), ConfigError);
  EXPECT_THROW(p.set_live("[]"), ConfigError);
}

TEST_F(LiveParameters, WhatIsRefusedIsNamedWithWhatIsAllowed) {
  EXPECT_EQ(refusal({"live.m=11"}),
            "set: live.m: value '11' is refused: out of range; allowed: 0 to 10 m");
  EXPECT_EQ(refusal({"stage.range_m=1"}),
            "set: stage.range_m: value '1' is refused: it can't change while running, start the "
            "stage again with it; allowed: live.m, live.noise, live.mode, live.xyz");
  EXPECT_EQ(refusal({"live.mm=1"}),
            "set: live.mm: value '1' is refused: unknown key (did you mean 'live.m'?); allowed: "
            "live.m, live.noise, live.mode, live.xyz");
  EXPECT_EQ(refusal({"live.m=9.5", "live.noise=0.6"}), "set: live.m: too noisy for so far");
  EXPECT_THAT(refusal({"live.m=11", "live.mode=none"}), HasSubstr("live.mode: value 'none'"));
  EXPECT_EQ(m, 0.1);
  EXPECT_EQ(noise, 0.02F);
}

TEST_F(ParameterFile, DescriptionAndValuesAreJson) {
  EXPECT_EQ(error("stage:\n  range_m: 6\n"), "");
  const auto list = nlohmann::json::parse(p.describe_json());
  ASSERT_EQ(list.size(), p.keys().size());
  EXPECT_EQ(list[0]["key"], "stage.range_m");
  EXPECT_EQ(list[0]["default"], 5.0);
  EXPECT_EQ(list[0]["unit"], "m");
  EXPECT_EQ(list[0]["allowed"], "0 to 100");
  const auto values = nlohmann::json::parse(p.values_json());
  EXPECT_EQ(values["stage.range_m"], 6.0);
  EXPECT_EQ(values["stage.mode"], "soft");
  EXPECT_EQ(values["stage.name"], "x");
  const auto result = nlohmann::json::parse(p.result_values_json());
  EXPECT_TRUE(result.contains("stage.range_m"));
  EXPECT_FALSE(result.contains("stage.name"));
}

TEST_F(ParameterFile, ValuesTextDependsOnValuesOnly) {
  const std::string before = p.result_values_json();
  EXPECT_EQ(error("", {"stage.name=other"}), "");
  EXPECT_EQ(p.result_values_json(), before);
  EXPECT_EQ(error("", {"stage.range_m=5.5"}), "");
  EXPECT_NE(p.result_values_json(), before);
}

TEST(SharedParameters, HoldNamesToWhatAKeyAllows) {
  const auto load = [](const std::string& text) {
    SharedConfig c;
    Parameters p;
    bind(p, c);
    p.load_text(text, "f", {});
    return c;
  };
  EXPECT_THROW(load("robot: a/b\n"), ConfigError);
  EXPECT_THROW(load("robot: r\nsensor:\n  name: '*'\n"), ConfigError);
  const SharedConfig c = load("robot: r\nmounting:\n  xyz_m: [0, 0, 1.7]\n");
  EXPECT_EQ(c.robot, "r");
  EXPECT_EQ(c.mounting.T_base_lidar().translation().z(), 1.7);
}

void load_shared(const std::string& text, const std::vector<std::string>& settings) {
  SharedConfig c;
  Parameters p;
  bind(p, c);
  p.load_text(text, "f", settings, owned_sections());
}

TEST(SharedParameters, SectionsThatNoProgramReadsAreUnknown) {
  EXPECT_NO_THROW(load_shared("driver: {port: 1}\naloam: {deskew: true}\n", {"store.path=/tmp"}));
  for (const std::string section : {"monitor", "recorder", "router"}) {
    EXPECT_THROW(load_shared(section + ": {port: 1}\n", {}), ConfigError) << section;
    EXPECT_THROW(load_shared("", {section + ".port=1"}), ConfigError) << section;
  }
}

TEST(SharedParameters, ThePublisherKeepsAllSweepsOfAReplaysWindow) {
  EXPECT_NO_THROW(load_shared("flow: {window: 64}\nrecovery: {keep_messages: 64}\n", {}));
  EXPECT_THROW(load_shared("flow: {window: 65}\nrecovery: {keep_messages: 64}\n", {}), ConfigError);
  const auto error = [](const std::string& text) {
    try {
      load_shared(text, {});
    } catch (const ConfigError& e) {
      return std::string(e.what());
    }
    return std::string();
  };
  EXPECT_THAT(error("flow:\n  window: 100\n"),
              HasSubstr("f:2: flow.window: must not exceed recovery.keep_messages (32)"));
  // The window has its default, and the file names the other key alone.
  EXPECT_THAT(error("recovery:\n  keep_messages: 4\n"),
              HasSubstr("f:2: flow.window: must not exceed recovery.keep_messages (4)"));
}

TEST(SharedParameters, AddressesAreCheckedWithTheirPlace) {
  const auto error = [](const std::string& text, const std::vector<std::string>& settings) {
    try {
      load_shared(text, settings);
    } catch (const ConfigError& e) {
      return std::string(e.what());
    }
    return std::string();
  };
  for (const char* good : {"0.0.0.0", "<stage>", "zloam-<stage>.svc", "[::1]", "::1", "robot-1"}) {
    EXPECT_EQ(error("", {std::string("zenoh.host=") + good}), "");
  }
  for (const char* bad : {"", "10.0.0.5:7447", "tcp/10.0.0.5", "10.0.0.5 ", "[::1]:7447", "[::1"}) {
    EXPECT_THAT(error("zenoh:\n  host: '" + std::string(bad) + "'\n", {}),
                HasSubstr("f:2: zenoh.host: '" + std::string(bad) + "': a name or an address"));
  }
  EXPECT_THAT(error("zenoh:\n  base_port: 0\n  connect: [tcp/router]\n", {}),
              HasSubstr("f:3: zenoh.connect: 'tcp/router': tcp/HOST:PORT is expected"));
  EXPECT_THAT(error("", {"zenoh.listen=[router:7447]"}),
              HasSubstr("--set zenoh.listen: zenoh.listen: 'router:7447': tcp/HOST:PORT"));
}

}  // namespace
}  // namespace zloam::runtime
