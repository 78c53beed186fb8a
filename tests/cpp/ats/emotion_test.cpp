#include "freetalk/ats/emotion.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include "../decimal_comma.h"

namespace freetalk::ats {
namespace {

const std::vector<std::string> kEmotions = {"neutral", "happy", "afraid"};

std::string message_of(const std::string& text) {
  try {
    parse_emotion_keys(text, kEmotions, 2.0);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(ParseEmotion, NamesAliasesAndMixtures) {
  EXPECT_TRUE(torch::allclose(parse_emotion("fear", kEmotions), torch::tensor({0.0F, 0.0F, 1.0F})));
  for (const char* text : {"happy:3,neutral:1", " happy : 3 , neutral "}) {
    EXPECT_TRUE(
        torch::allclose(parse_emotion(text, kEmotions), torch::tensor({0.25F, 0.75F, 0.0F})))
        << text;
  }
  for (const char* bad : {"hungry", "happy:", "happy:-1", "happy:0", "", "happy:x", "happy:nan"}) {
    EXPECT_THROW(parse_emotion(bad, kEmotions), std::invalid_argument) << bad;
  }
  EXPECT_TRUE(torch::equal(parse_emotion("Joy", kEmotions), parse_emotion("happy", kEmotions)));
  EXPECT_TRUE(
      torch::allclose(parse_emotion("happy:0.3", kEmotions), torch::tensor({0.7F, 0.3F, 0.0F})));
  EXPECT_NE(message_of("happy:70").find("@INTENSITY"), std::string::npos);
  EXPECT_NE(message_of("hapy").find("did you mean 'happy'"), std::string::npos);
  EXPECT_NE(message_of("0=neutral, 2.5=happy").find("separated by ';'"), std::string::npos);
  try {
    parse_emotion("hungry", kEmotions);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("neutral, happy, afraid"), std::string::npos);
  }
}

TEST(ParseEmotionKeys, TimesMixturesIntensities) {
  const auto keys =
      parse_emotion_keys("0=neutral@1; 2.5 = happy:0.7, fear:0.3 @ 2.5;4=happy", kEmotions, 1.5);
  ASSERT_EQ(keys.size(), 3u);
  EXPECT_EQ(keys[1].time_s, 2.5);
  EXPECT_TRUE(torch::allclose(keys[1].emotion, torch::tensor({0.0F, 0.7F, 0.3F})));
  EXPECT_EQ(keys[0].intensity, 1.0);
  EXPECT_EQ(keys[1].intensity, 2.5);
  EXPECT_EQ(keys[2].intensity, 1.5);
  EXPECT_EQ(parse_emotion_keys("happy", kEmotions, 2.0).at(0).intensity, 2.0);
  EXPECT_EQ(parse_emotion_keys("happy@3", kEmotions, 2.0).at(0).intensity, 3.0);
}

TEST(ParseEmotion, ReadsNumbersTheSameUnderADecimalComma) {
  const std::vector<std::string> names = {"neutral", "happy"};
  const freetalk::testing::DecimalComma comma;
  if (!comma.is_set()) GTEST_SKIP() << "no locale with a decimal comma can be had";
  const auto keys = parse_emotion_keys("0=neutral;1.5=happy:0.5,neutral:0.5@2.5", names, 1.0);
  EXPECT_EQ(keys.at(1).time_s, 1.5);
  EXPECT_EQ(keys.at(1).intensity, 2.5);
  EXPECT_EQ(keys.at(1).emotion[1].item<float>(), 0.5F);
}

TEST(ParseEmotionKeys, ErrorsQuoteThePartAtFault) {
  EXPECT_NE(message_of("0=neutral;happy").find("'happy' has no time"), std::string::npos);
  EXPECT_NE(message_of("1=neutral;1=happy").find("must rise"), std::string::npos);
  EXPECT_NE(message_of("soon=neutral").find("'soon'"), std::string::npos);
  EXPECT_NE(message_of("-1=neutral").find("'-1'"), std::string::npos);
  EXPECT_NE(message_of("0=happy@much").find("'much'"), std::string::npos);
  EXPECT_NE(message_of("0=hungry").find("known are"), std::string::npos);
  EXPECT_NE(message_of("").find("empty"), std::string::npos);
}

TEST(Interpolate, IsLinearBetweenKeysAndHeldOutside) {
  const auto keys = parse_emotion_keys("1=neutral@1;2=happy@3", kEmotions, 2.0);
  const Affect felt = interpolate(keys, 7, 2.0);  // 0, 0.5 ... 3 s
  const at::Tensor happy = torch::tensor({0.0F, 0.0F, 0.0F, 0.5F, 1.0F, 1.0F, 1.0F});
  EXPECT_TRUE(torch::allclose(felt.weight, torch::stack({1 - happy, happy}, 1)));
  EXPECT_TRUE(torch::equal(felt.emotion, torch::tensor({{1.0F, 0.0F, 0.0F}, {0.0F, 1.0F, 0.0F}})));
  EXPECT_TRUE(torch::equal(felt.intensity, torch::tensor({1.0F, 3.0F})));
  EXPECT_THROW(interpolate({keys[1], keys[0]}, 7, 2.0), std::invalid_argument);
  EXPECT_THROW(interpolate({}, 7, 2.0), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::ats
